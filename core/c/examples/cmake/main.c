/* Plays a nod, rests, and prints the pulses of two servos, one line a tick: the body without a robot.
 *
 *     body MODEL.kara
 */
#include "karakuri.h"

#include <stdio.h>

enum { SERVOS = 2, TICKS = 150, TICK_US = 20000 };

static const karakuri_servo_t servos[SERVOS] = {
    {0, 700, 1500, 2300, 1500, 10 * 65536, 4000, 40000},
    {2, 700, 1500, 2300, 1400, -10 * 65536, 4000, 40000},
};

static karakuri_storage_t storage;

/* In flash on a chip; aligned, because the kernels load whole words. */
static union {
    uint64_t align[2];
    uint8_t bytes[200000];
} blob __attribute__((aligned(16)));

static size_t read_blob(const char *path) {
    FILE *file = fopen(path, "rb");
    if (!file) return 0;
    size_t bytes = fread(blob.bytes, 1, sizeof blob.bytes, file);
    fclose(file);
    return bytes;
}

int main(int argc, char **argv) {
    size_t blob_bytes = argc == 2 ? read_blob(argv[1]) : 0;
    if (!blob_bytes) {
        fprintf(stderr, "usage: body MODEL.kara\n");
        return 2;
    }
    karakuri_t *body;
    karakuri_status_t status = karakuri_init(&body, &storage, blob.bytes, blob_bytes, servos, SERVOS, 7);
    if (status != KARAKURI_OK) {
        fprintf(stderr, "cannot make a body: status %d\n", (int)status);
        return 1;
    }
    int32_t nod = karakuri_action(body, "nod");
    karakuri_wake(body);
    if (nod < 0 || karakuri_play(body, (uint16_t)nod, 2000, 7) != KARAKURI_OK) {
        fprintf(stderr, "this model cannot nod\n");
        return 1;
    }
    for (int tick = 0; tick < TICKS; tick++) {
        uint16_t pulses_us[SERVOS];
        karakuri_tick(body, TICK_US, pulses_us, SERVOS);
        printf("%u,%u\n", (unsigned)pulses_us[0], (unsigned)pulses_us[1]);
    }
    karakuri_relax(body);
    return karakuri_fault(body);
}
