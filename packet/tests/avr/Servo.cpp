#include "Servo.h"

static const uint8_t MOST = 12;
static const uint16_t TICKS_PER_US = 2; // 16 MHz divided by 8
static const uint16_t PERIOD = 20000 * TICKS_PER_US;
static volatile uint16_t ticks[MOST];
static volatile uint8_t pins[MOST]; // 0 while no servo is attached
static volatile uint8_t servos = 0;
static volatile uint8_t current = 0; // the servo whose pulse ends next, counted from 1; 0 in the pause

ISR(TIMER1_COMPA_vect) {
    if (current == 0) TCNT1 = 0;
    if (current > 0 && pins[current - 1]) digitalWrite(pins[current - 1], LOW);
    current++;
    if (current > servos) {
        current = 0;
        OCR1A = PERIOD;
        return;
    }
    OCR1A = TCNT1 + ticks[current - 1];
    if (pins[current - 1]) digitalWrite(pins[current - 1], HIGH);
}

Servo::Servo() : index(servos++) {
    ticks[index] = 1500 * TICKS_PER_US;
}

uint8_t Servo::attach(int pin) {
    pinMode((uint8_t)pin, OUTPUT);
    uint8_t before = SREG;
    cli();
    if (!(TIMSK1 & _BV(OCIE1A))) {
        TCCR1A = 0;
        TCCR1B = _BV(CS11);
        TCNT1 = 0;
        OCR1A = PERIOD;
        TIFR1 = _BV(OCF1A);
        TIMSK1 = _BV(OCIE1A);
    }
    pins[index] = (uint8_t)pin;
    SREG = before;
    return index;
}

void Servo::detach() {
    pins[index] = 0;
}

void Servo::writeMicroseconds(int us) {
    uint8_t before = SREG;
    cli();
    ticks[index] = (uint16_t)us * TICKS_PER_US;
    SREG = before;
}
