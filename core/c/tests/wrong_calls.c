/* Wrong calls, one after another; prints the line of the first that is not answered as the header says. */
#include "karakuri.h"

#include <stdio.h>

#define CHECK(condition) \
    if (!(condition)) { \
        printf("%s:%d: %s\n", __FILE__, __LINE__, #condition); \
        return 1; \
    }

static karakuri_storage_t storage;
static uint8_t blob[65536] __attribute__((aligned(16)));

int main(int argc, char **argv) {
    FILE *file = argc == 2 ? fopen(argv[1], "rb") : NULL;
    CHECK(file);
    size_t bytes = fread(blob, 1, sizeof blob, file);
    fclose(file);
    karakuri_servo_t servo = {0, 700, 1500, 2300, 1500, 655360, 4000, 40000};
    karakuri_servo_t swapped = {0, 2300, 1500, 700, 1500, 655360, 4000, 40000};
    karakuri_servo_t many[40];
    for (int i = 0; i < 40; i++) many[i] = servo;
    karakuri_t *body = NULL;

    CHECK(karakuri_init(NULL, &storage, blob, bytes, &servo, 1, 7) == KARAKURI_BAD_ARGUMENT);
    CHECK(karakuri_init(&body, NULL, blob, bytes, &servo, 1, 7) == KARAKURI_BAD_ARGUMENT);
    CHECK(karakuri_init(&body, &storage, NULL, bytes, &servo, 1, 7) == KARAKURI_BAD_ARGUMENT);
    CHECK(karakuri_init(&body, &storage, blob, bytes, NULL, 1, 7) == KARAKURI_BAD_ARGUMENT);
    CHECK(karakuri_init(&body, &storage, blob, bytes - 1, &servo, 1, 7) == KARAKURI_BAD_BLOB);
    CHECK(karakuri_init(&body, &storage, blob, bytes, &swapped, 1, 7) == KARAKURI_BAD_SERVO);
    CHECK(karakuri_init(&body, &storage, blob, bytes, NULL, 0, 7) == KARAKURI_BAD_SERVO);
    CHECK(karakuri_init(&body, &storage, blob, bytes, many, 40, 7) == KARAKURI_BAD_SERVO);
    blob[100] ^= 1;
    CHECK(karakuri_init(&body, &storage, blob, bytes, &servo, 1, 7) == KARAKURI_BAD_BLOB);
    blob[100] ^= 1;
    CHECK(body == NULL);
    CHECK(karakuri_play(NULL, 0, 2000, 1) == KARAKURI_BAD_ARGUMENT);
    CHECK(karakuri_tick(NULL, 20000, NULL, 0) == 0);
    CHECK(karakuri_action(NULL, "nod") == -1);

    CHECK(karakuri_init(&body, &storage, blob, bytes, &servo, 1, 7) == KARAKURI_OK);
    CHECK(karakuri_state(body) == KARAKURI_RELEASED);
    CHECK(karakuri_action(body, "fly") == -1 && karakuri_action(body, NULL) == -1);
    CHECK(karakuri_play(body, 999, 2000, 1) == KARAKURI_UNKNOWN_ACTION);
    uint16_t nod = (uint16_t)karakuri_action(body, "nod");
    CHECK(karakuri_play(body, nod, 1, 1) == KARAKURI_BAD_DURATION);
    karakuri_wake(body);
    for (int i = 0; i < 100; i++) {
        karakuri_status_t status = karakuri_then(body, nod, 2000, 1);
        CHECK(status == KARAKURI_OK || status == KARAKURI_QUEUE_FULL);
        CHECK(i < 99 || status == KARAKURI_QUEUE_FULL);
    }
    uint16_t pulses_us[3] = {9, 9, 9};
    CHECK(karakuri_tick(body, 20000, pulses_us, 3) == 1);
    CHECK(pulses_us[0] == 1500 && pulses_us[1] == 9);
    karakuri_latch(body, 3);
    karakuri_tick(body, 20000, pulses_us, 1);
    CHECK(karakuri_state(body) == KARAKURI_FAULTED && karakuri_fault(body) == 259);
    karakuri_clear_fault(body);
    CHECK(karakuri_fault(body) == 0);
    karakuri_relax(body);
    karakuri_tick(body, 20000, pulses_us, 1);
    CHECK(pulses_us[0] == 0 && karakuri_state(body) == KARAKURI_RELEASED);
    return 0;
}
