"""`python -m physkin_ros`: run the drape node."""

import sys

from physkin_ros.node.node_process import main

if __name__ == "__main__":
    sys.exit(main())
