/* Runs the tachometer's firmware on a simulated ATmega328P (libsimavr), its sensor pin driven and its line connected.
 *
 *   simavr_host FIRMWARE.elf script < SCRIPT     lines "edge CYCLE", "byte CYCLE VALUE", "end CYCLE", cycles rising;
 *                                                prints "CYCLE VALUE" for each byte that the board sends, and
 *                                                "relay CYCLE VALUE" for each change of its pin
 *   simavr_host FIRMWARE.elf pty PERIOD_US       in real time: prints the name of a terminal, serves it until it is hung
 *                                                up, the mark passing every PERIOD_US
 */
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define HZ 16000000ULL

static avr_t *avr;
static avr_irq_t *pin, *line_in;
static int terminal = -1;

static void said(struct avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    uint8_t byte = (uint8_t)value;
    if (terminal < 0) printf("%llu %u\n", (unsigned long long)avr->cycle, byte);
    else if (write(terminal, &byte, 1) < 0) return;
}

static void switched(struct avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    if (terminal < 0) printf("relay %llu %u\n", (unsigned long long)avr->cycle, value);
}

static void quiet(avr_t *of, const int level, const char *format, va_list arguments) {
    (void)of, (void)level, (void)format, (void)arguments;
}

static void run_to(avr_cycle_count_t cycle) {
    while (avr->cycle < cycle) {
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) exit(3);
    }
}

static void edge(void) {
    avr_raise_irq(pin, 0);
    run_to(avr->cycle + HZ / 5000); /* low for 200 us, as the tape's width makes it */
    avr_raise_irq(pin, 1);
}

static void script(void) {
    char what[8];
    unsigned long long cycle;
    unsigned value;
    while (scanf("%7s %llu", what, &cycle) == 2) {
        run_to(cycle);
        if (!strcmp(what, "end")) return;
        if (!strcmp(what, "edge")) edge();
        if (!strcmp(what, "byte") && scanf("%u", &value) == 1) avr_raise_irq(line_in, value);
    }
}

static void serve(uint64_t period) {
    int slave;
    char name[64];
    struct timespec pause = {0, 200000}, boot = {0, 50000000}, begun, now;
    struct pollfd waiting;
    if (openpty(&terminal, &slave, name, NULL, NULL)) exit(4);
    close(slave); /* from now on a hang-up shows that nobody has the terminal open */
    waiting = (struct pollfd){terminal, POLLIN, 0};
    puts(name);
    fflush(stdout);
    do nanosleep(&pause, NULL); /* opening it resets the board */
    while (poll(&waiting, 1, 0) && waiting.revents & POLLHUP);
    nanosleep(&boot, NULL);
    fcntl(terminal, F_SETFL, O_NONBLOCK);
    uint64_t next = period;
    clock_gettime(CLOCK_MONOTONIC, &begun);
    while (!(poll(&waiting, 1, 0) && waiting.revents & POLLHUP)) {
        uint8_t bytes[64];
        clock_gettime(CLOCK_MONOTONIC, &now);
        uint64_t cycle = (uint64_t)((now.tv_sec - begun.tv_sec) * 1000000000LL + now.tv_nsec - begun.tv_nsec) * 16 / 1000;
        if (cycle > 60 * HZ) return;
        for (; next < cycle; next += period) {
            run_to(next);
            edge();
        }
        run_to(cycle);
        ssize_t count = read(terminal, bytes, sizeof bytes);
        for (ssize_t k = 0; k < count; k++) {
            avr_raise_irq(line_in, bytes[k]);
            run_to(avr->cycle + HZ / 50000); /* ten bits at 500 kBd */
        }
        nanosleep(&pause, NULL);
    }
}

int main(int argc, char **argv) {
    elf_firmware_t firmware = {{0}};
    avr_global_logger_set(quiet);
    if (argc < 3 || elf_read_firmware(argv[1], &firmware)) return 2;
    avr = avr_make_mcu_by_name("atmega328p");
    if (!avr || avr_init(avr)) return 2;
    firmware.frequency = HZ;
    avr_load_firmware(avr, &firmware);
    avr->frequency = HZ;
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    pin = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 2);
    line_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), said, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 4), switched, NULL);
    avr_raise_irq(pin, 1);
    if (!strcmp(argv[2], "script")) script();
    else serve(strtoull(argv[3], NULL, 10) * 16);
    return 0;
}
