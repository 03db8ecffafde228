// A body with two servos at pins 9 and 10 of an Arduino with a Cortex-M (Nano 33 BLE, Portenta, Giga, RP2040 boards).
//
// Beside this file: karakuri.h, model.h with `const uint8_t model[]` (`xxd -i`, with __attribute__((aligned(16)))), and the
// static library as core/c/README.md says.
#include <Servo.h>
#include "karakuri.h"
#include "model.h"

static const karakuri_servo_t calibration[] = {
    {0, 700, 1500, 2300, 1500, 10 * 65536L, 4000, 40000},
    {2, 700, 1500, 2300, 1400, -10 * 65536L, 4000, 40000},
};
static const uint8_t pins[] = {9, 10};

static karakuri_storage_t storage;
static karakuri_t *body;
static Servo servos[2];
static unsigned long last_us;

void setup() {
    pinMode(LED_BUILTIN, OUTPUT);
    if (karakuri_init(&body, &storage, model, sizeof model, calibration, 2, 7) != KARAKURI_OK) {
        digitalWrite(LED_BUILTIN, HIGH);
        for (;;) {}
    }
    karakuri_wake(body);
    karakuri_idle(body, true);
    last_us = micros();
}

void loop() {
    unsigned long elapsed_us = micros() - last_us;
    if (elapsed_us < 20000) return;
    last_us += elapsed_us;
    uint16_t pulses_us[2];
    karakuri_tick(body, elapsed_us, pulses_us, 2);
    for (int i = 0; i < 2; i++) {
        if (pulses_us[i] == 0) {
            servos[i].detach();
        } else {
            if (!servos[i].attached()) servos[i].attach(pins[i]);
            servos[i].writeMicroseconds(pulses_us[i]);
        }
    }
}
