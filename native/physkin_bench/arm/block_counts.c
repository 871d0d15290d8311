/* A plugin of qemu (its plugin interface, version 1): how often each block of instructions ran, a line
 * "address instructions count" for each, into the file that `out=` names. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

/* Of qemu-plugin.h, which Debian has no package of. */
typedef uint64_t qemu_plugin_id_t;
struct qemu_plugin_tb;
typedef void translated_callback(qemu_plugin_id_t id, struct qemu_plugin_tb* block);
typedef void exit_callback(qemu_plugin_id_t id, void* data);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb* block);
uint64_t qemu_plugin_tb_vaddr(const struct qemu_plugin_tb* block);
void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t id, translated_callback* callback);
void qemu_plugin_register_vcpu_tb_exec_inline(struct qemu_plugin_tb* block, int add, void* counter, uint64_t amount);
void qemu_plugin_register_atexit_cb(qemu_plugin_id_t id, exit_callback* callback, void* data);

#define EXPORTED __attribute__((visibility("default")))
EXPORTED int qemu_plugin_version = 1;

struct block {
  uint64_t address, instructions, count;
  struct block* next;
};
static struct block* blocks;
static const char* out;

static void translated(qemu_plugin_id_t id, struct qemu_plugin_tb* tb) {
  struct block* block = calloc(1, sizeof *block);
  (void)id;
  block->address = qemu_plugin_tb_vaddr(tb);
  block->instructions = qemu_plugin_tb_n_insns(tb);
  block->next = blocks;
  blocks = block;
  qemu_plugin_register_vcpu_tb_exec_inline(tb, 0, &block->count, 1);
}

static void ended(qemu_plugin_id_t id, void* data) {
  FILE* file = fopen(out, "w");
  (void)id, (void)data;
  for (const struct block* b = blocks; file != NULL && b != NULL; b = b->next) {
    fprintf(file, "%" PRIu64 " %" PRIu64 " %" PRIu64 "\n", b->address, b->instructions, b->count);
  }
  if (file != NULL) fclose(file);
}

EXPORTED int qemu_plugin_install(qemu_plugin_id_t id, const void* info, int argc, char** argv) {
  (void)info;
  if (argc != 1) return 1;
  out = argv[0] + sizeof "out=" - 1;
  qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
  qemu_plugin_register_atexit_cb(id, ended, NULL);
  return 0;
}
