// Counts the instructions that an emulated processor executes in marked regions of a program.
//
// In:  a running QEMU, and a program that marks a region by two instructions that do nothing:
//          mov r10, r10   a region begins, all counts are zero
//          mov r11, r11   it ends
// Out: a text file. For each region a line `region <instructions>`, then for each address that was executed in it a
//      line `<address in hexadecimal> <times>`, in order of addresses.
//
// Why here: counts are the same in every run on every machine, which no time is. They are counts of instructions:
// QEMU models no pipeline, no flash and no cache. An instruction whose condition is false is counted as well.
//
// Build: cc -shared -fPIC -O2 -DPLUGIN_API=N (N: see `plugin.rs`)     Run: qemu-system-arm -plugin FILE.so,out=COUNTS
// Source: QEMU's manual, "TCG Plugins". Its header qemu-plugin.h belongs to no Debian package of QEMU 7.2, so the few
// declarations that are needed stand here; QEMU itself resolves the functions when it loads the plugin.

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))

typedef uint64_t plugin_id;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
typedef void translate_callback(plugin_id, struct qemu_plugin_tb *);
typedef void execute_callback(unsigned processor, void *argument);
enum { CALLBACK_READS_NO_REGISTERS = 0 };

void qemu_plugin_register_vcpu_tb_trans_cb(plugin_id, translate_callback *);
void qemu_plugin_register_vcpu_insn_exec_cb(struct qemu_plugin_insn *, execute_callback *, int flags, void *argument);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
uint64_t qemu_plugin_insn_vaddr(const struct qemu_plugin_insn *);
#if PLUGIN_API >= 3
size_t qemu_plugin_insn_data(const struct qemu_plugin_insn *, void *destination, size_t length);
#else
const void *qemu_plugin_insn_data(const struct qemu_plugin_insn *);
#endif

EXPORT int qemu_plugin_version = PLUGIN_API;

enum { REGION_BEGINS = 0x46d2, REGION_ENDS = 0x46db }; // mov r10, r10; mov r11, r11

// One counter per halfword of the 32-bit address space, in pages that exist once something in them was translated.
enum { PAGE_BITS = 12, COUNTERS_PER_PAGE = 1 << (PAGE_BITS - 1), PAGES = 1 << (32 - PAGE_BITS) };
static uint64_t *pages[PAGES];
// Of the pages that exist: a look at a million is too much for each of many regions.
static uint32_t first_page = PAGES, end_page;
static FILE *out;

static uint64_t *counter_at(uint32_t address) {
    uint64_t **page = &pages[address >> PAGE_BITS];
    if (!*page) *page = calloc(COUNTERS_PER_PAGE, sizeof **page);
    if (!*page) abort();
    uint32_t number = address >> PAGE_BITS;
    if (number < first_page) first_page = number;
    if (number >= end_page) end_page = number + 1;
    return &(*page)[(address / 2) % COUNTERS_PER_PAGE];
}

static void on_begin(unsigned processor, void *argument) {
    for (uint32_t page = first_page; page < end_page; page++)
        if (pages[page]) memset(pages[page], 0, COUNTERS_PER_PAGE * sizeof(uint64_t));
}

static void on_end(unsigned processor, void *argument) {
    uint64_t total = 0;
    for (uint32_t page = first_page; page < end_page; page++)
        for (uint32_t i = 0; pages[page] && i < COUNTERS_PER_PAGE; i++) total += pages[page][i];
    fprintf(out, "region %llu\n", (unsigned long long)total);
    for (uint32_t page = first_page; page < end_page; page++)
        for (uint32_t i = 0; pages[page] && i < COUNTERS_PER_PAGE; i++)
            if (pages[page][i])
                fprintf(out, "%x %llu\n", page << PAGE_BITS | 2 * i, (unsigned long long)pages[page][i]);
    fflush(out);
}

static void on_other(unsigned processor, void *counter) { ++*(uint64_t *)counter; }

static uint16_t first_halfword(const struct qemu_plugin_insn *instruction) {
    uint16_t halfword = 0;
#if PLUGIN_API >= 3
    qemu_plugin_insn_data(instruction, &halfword, sizeof halfword);
#else
    memcpy(&halfword, qemu_plugin_insn_data(instruction), sizeof halfword);
#endif
    return halfword;
}

// QEMU translates a block of instructions once and executes the translation as often as the program comes by.
static void on_translate(plugin_id id, struct qemu_plugin_tb *block) {
    for (size_t i = 0; i < qemu_plugin_tb_n_insns(block); i++) {
        struct qemu_plugin_insn *instruction = qemu_plugin_tb_get_insn(block, i);
        // No question of its size: four bytes before the end of a page, QEMU looks at the next instruction as well and
        // says 4. No wide instruction begins with these halfwords.
        uint16_t opcode = first_halfword(instruction);
        execute_callback *callback = on_other;
        if (opcode == REGION_BEGINS) callback = on_begin;
        if (opcode == REGION_ENDS) callback = on_end;
        uint64_t *counter = counter_at((uint32_t)qemu_plugin_insn_vaddr(instruction));
        qemu_plugin_register_vcpu_insn_exec_cb(instruction, callback, CALLBACK_READS_NO_REGISTERS, counter);
    }
}

EXPORT int qemu_plugin_install(plugin_id id, const void *info, int argument_count, char **arguments) {
    for (int i = 0; i < argument_count; i++)
        if (!strncmp(arguments[i], "out=", 4)) out = fopen(arguments[i] + 4, "w");
    if (!out) return -1;
    qemu_plugin_register_vcpu_tb_trans_cb(id, on_translate);
    return 0;
}
