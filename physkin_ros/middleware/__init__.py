"""DDS and the executor: domains, shared memory, discovery of subscribers, spinning."""
