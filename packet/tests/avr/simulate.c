/* Runs a program for an Arduino Uno in simavr, with the bytes of standard input on its serial port, one after another, and
 * after the last one for so many milliseconds. Prints the width in microseconds of the last pulse on each of the pins 9 to
 * 11, 0 for none, and the byte at an address of the memory: first after the last byte, then at the end.
 *
 *     simulate PROGRAM.elf MILLISECONDS ADDRESS */
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

/* simavr takes 94 us to receive a byte at 115200 baud. 104 us makes 72 packets a second. */
enum { PINS = 3, FIRST_PIN = 1, MHZ = 16, BYTE_US = 104 };

struct pulse {
    avr_t *avr;
    avr_cycle_count_t rose, last_end;
    unsigned width_us;
};

/* Standard output is for the pulses. An error, such as a byte that the serial port has lost, ends the run. */
static void log_message(struct avr_t *avr, const int level, const char *format, va_list arguments) {
    (void)avr;
    if (level > LOG_ERROR) return;
    vfprintf(stderr, format, arguments);
    exit(1);
}

static void pin_changed(struct avr_irq_t *irq, uint32_t value, void *context) {
    struct pulse *pulse = context;
    (void)irq;
    if (value) {
        pulse->rose = pulse->avr->cycle;
    } else if (pulse->rose) {
        pulse->width_us = (unsigned)((pulse->avr->cycle - pulse->rose) / MHZ);
        pulse->last_end = pulse->avr->cycle;
    }
}

static void run_for(avr_t *avr, uint64_t us) {
    avr_cycle_count_t end = avr->cycle + us * MHZ;
    while (avr->cycle < end) {
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) {
            fprintf(stderr, "the program has crashed\n");
            exit(1);
        }
    }
}

/* A pin without a pulse for 50 ms has none. */
static void print_state(const struct pulse *pulses, long address) {
    for (int i = 0; i < PINS; i++) {
        int runs = pulses[i].width_us > 0 && pulses[i].avr->cycle - pulses[i].last_end < 50000 * MHZ;
        printf("%u ", runs ? pulses[i].width_us : 0);
    }
    printf("%d ", pulses[0].avr->data[address]);
}

int main(int count, char **arguments) {
    static elf_firmware_t firmware;
    struct pulse pulses[PINS] = {0};
    avr_global_logger_set(log_message);
    if (count != 4 || elf_read_firmware(arguments[1], &firmware) != 0) return 2;
    avr_t *avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    avr->frequency = MHZ * 1000000;
    avr_load_firmware(avr, &firmware);
    uint32_t flags = 0; /* neither standard output nor sleep */
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_t *input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    for (int i = 0; i < PINS; i++) {
        pulses[i].avr = avr;
        avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), FIRST_PIN + i), pin_changed, &pulses[i]);
    }
    run_for(avr, 100000);
    for (int byte = getchar(); byte != EOF; byte = getchar()) {
        avr_raise_irq(input, (uint32_t)byte);
        run_for(avr, BYTE_US);
    }
    print_state(pulses, atol(arguments[3]));
    run_for(avr, 1000ul * (unsigned long)atol(arguments[2]));
    print_state(pulses, atol(arguments[3]));
    return 0;
}
