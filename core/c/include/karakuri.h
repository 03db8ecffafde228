/* karakuri: seeded, never-repeating motion for microcontrollers.
 *
 * One body is a blob in flash (from `host-trainer quantize`), a calibration of its servos, and KARAKURI_STORAGE_BYTES of memory
 * that the caller owns. No heap, no clock, no global state; the same calls give the same pulses on every chip.
 *
 *     static karakuri_storage_t storage;
 *     karakuri_t *body;
 *     if (karakuri_init(&body, &storage, blob, sizeof blob, servos, 2, 7) != KARAKURI_OK) { ... }
 *     karakuri_wake(body);
 *     karakuri_idle(body, true);
 *     for (;;) {
 *         uint16_t pulses_us[2];
 *         karakuri_tick(body, elapsed_us, pulses_us, 2);   // 0: no pulse, the servo is released
 *     }
 *
 * Not a safety-rated system: keep a hardware power cut. One body may not be used by two threads or interrupts at once.
 */
#ifndef KARAKURI_H
#define KARAKURI_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Memory of one body: models of up to 32 channels and 256 units in the widest layer. */
#define KARAKURI_STORAGE_BYTES 13312

typedef union {
    uint64_t align;
    unsigned char bytes[KARAKURI_STORAGE_BYTES];
} karakuri_storage_t;

/* A body; lies in the storage, which must not be moved, copied or used otherwise. */
typedef struct karakuri karakuri_t;

typedef enum {
    KARAKURI_OK = 0,
    /* A pointer is null that may not be, or the storage is not aligned to 8 bytes. */
    KARAKURI_BAD_ARGUMENT = 1,
    /* The blob is damaged, cut, not aligned to 16 bytes, or of another version. */
    KARAKURI_BAD_BLOB = 2,
    /* The model has more channels or wider layers than the storage has room for. */
    KARAKURI_TOO_LARGE = 3,
    /* Pulses out of order, a limit of 0, a park pulse outside the range, more than 32 servos, or none here and in the blob. */
    KARAKURI_BAD_SERVO = 4,
    /* The model has no such action. */
    KARAKURI_UNKNOWN_ACTION = 5,
    /* The model never learned motions of this length. */
    KARAKURI_BAD_DURATION = 6,
    /* As many motions wait as fit. */
    KARAKURI_QUEUE_FULL = 7
} karakuri_status_t;

typedef enum {
    KARAKURI_RELEASED = 0,
    KARAKURI_FAULTED = 1,
    KARAKURI_HELD = 2,
    KARAKURI_MOVING = 3,
    KARAKURI_RESTING = 4
} karakuri_state_t;

/* Calibration of one servo. */
typedef struct {
    /* The channel of the pose that it follows. */
    uint16_t channel;
    uint16_t pulse_us_min;
    /* Where channel value 0 leads. */
    uint16_t pulse_us_neutral;
    uint16_t pulse_us_max;
    /* Where it stands when nobody drives it, and starts from. */
    uint16_t pulse_us_park;
    /* Microseconds for each unit of the channel, times 65536; negative where the servo turns the other way. */
    int32_t pulse_us_per_unit_q16;
    /* Speed and acceleration limit, microseconds of pulse a second, and a second squared. */
    uint32_t pulse_us_per_s_max;
    uint32_t pulse_us_per_s2_max;
} karakuri_servo_t;

/* Each 4096 where the model was trained: intensity 0..8192, rate 1024..16384, stillness 0..4096, variety 0..8192. */
typedef struct {
    uint16_t intensity_q12;
    uint16_t rate_q12;
    uint16_t stillness_q12;
    uint16_t variety_q12;
} karakuri_dials_t;

/* Makes a body, its servos released. The blob stays where it is and must not change; so must the storage. No servos (NULL, 0):
 * those of the blob, from `host-trainer calibrate`. */
karakuri_status_t karakuri_init(karakuri_t **body, karakuri_storage_t *storage, const uint8_t *blob, size_t blob_bytes,
                                const karakuri_servo_t *servos, size_t servo_count, uint64_t seed);

/* Number of the action of this name, -1: none. */
int32_t karakuri_action(const karakuri_t *body, const char *name);

/* Plays a motion now, or after those that wait. */
karakuri_status_t karakuri_play(karakuri_t *body, uint16_t action, uint32_t duration_ms, uint64_t seed);
karakuri_status_t karakuri_then(karakuri_t *body, uint16_t action, uint32_t duration_ms, uint64_t seed);

/* Whether the body moves on its own between motions. */
void karakuri_idle(karakuri_t *body, bool is_alive);

/* Turns the dials, each as far as it goes. */
void karakuri_set_dials(karakuri_t *body, karakuri_dials_t dials);

/* Comes to a stand in the midst of the motion; goes on. */
void karakuri_hold(karakuri_t *body);
void karakuri_resume(karakuri_t *body);

/* Ends everything gently; what waits is forgotten. */
void karakuri_soft_stop(karakuri_t *body);

/* Releases the servos at once. */
void karakuri_relax(karakuri_t *body);

/* Servos on: the park pose, then softly to the body's. */
void karakuri_wake(karakuri_t *body);

/* Lets time pass since the last tick. Writes the pulses of the first `count` servos, 0: no pulse; returns how many. */
size_t karakuri_tick(karakuri_t *body, uint32_t elapsed_us, uint16_t *pulses_us, size_t count);

karakuri_state_t karakuri_state(const karakuri_t *body);

/* Code of the latched fault, 0: none, or servos released. Until it is cleared the body holds still. */
uint16_t karakuri_fault(const karakuri_t *body);
void karakuri_clear_fault(karakuri_t *body);

/* Latches a fault of your own, code 256 + number. */
void karakuri_latch(karakuri_t *body, uint8_t number);

#ifdef __cplusplus
}
#endif

#endif
