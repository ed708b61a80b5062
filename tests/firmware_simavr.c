/* A computer's USB port with an ATmega32U4 in it: runs the firmware's ELF file in simavr and speaks USB with it.
 * For tests/output/serial/test_firmware_avr_build.py, over standard input and output:
 *     'C' setup[8] n[2] data[n]   control transfer  -> n[2] data[n]; n = 0xFFFF: stalled
 *     'T' ms[2] n[2] data[n]      let time pass; data goes to the serial port (endpoint 2)
 *                                 -> n[2] what the serial port sent (endpoint 3), n[2] reports (endpoint 4), 10 bytes each
 *     'P' ms[2] n[2] data[n]      the same, with data through the pins RX and TX instead, at 115200 baud
 *     'R'                         USB reset -> n[2] = 0
 */
#include <simavr/avr_uart.h>
#include <simavr/avr_usb.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MHZ = 16, POLL = 100, BYTE = 87, ROOM = 60000 }; /* MHz; us between two looks, and bytes on the pins; bytes */

static avr_t *avr;
static FILE *answers; /* simavr itself writes to standard output */

static void run(unsigned us) {
    avr_cycle_count_t end = avr->cycle + (avr_cycle_count_t)us * MHZ;
    while (avr->cycle < end) {
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) {
            fprintf(stderr, "the program ended or crashed\n");
            exit(3);
        }
    }
}

static int usb(uint32_t what, uint8_t endpoint, uint8_t *data, unsigned *n) {
    struct avr_io_usb io = {endpoint, *n, data};
    int code = avr_ioctl(avr, what, &io);
    *n = io.sz;
    return code;
}

/* Waits until the endpoint has or takes a packet; -1: stalled. */
static int packet(uint32_t what, uint8_t *data, unsigned *n) {
    unsigned size = *n, tries;
    for (tries = 0; tries < 1000; tries++) {
        int code = usb(what, 0, data, n);
        if (code != AVR_IOCTL_USB_NAK)
            return code == AVR_IOCTL_USB_STALL ? -1 : 0;
        *n = size;
        run(20);
    }
    fprintf(stderr, "endpoint 0 does not answer\n");
    exit(4);
}

static void put(const uint8_t *data, unsigned n, unsigned shown) {
    putc(shown & 255, answers);
    putc(shown >> 8, answers);
    if (n)
        fwrite(data, 1, n, answers);
}

static unsigned get16(void) {
    unsigned low = (unsigned)getchar();
    return low | (unsigned)getchar() << 8;
}

static void control(void) {
    uint8_t setup[8], data[1024];
    unsigned n = 8, wanted, got = 0;
    if (fread(setup, 1, 8, stdin) != 8)
        exit(1);
    wanted = get16();
    if (fread(data, 1, wanted, stdin) != wanted)
        exit(1);
    usb(AVR_IOCTL_USB_SETUP, 0, setup, &n);
    run(50);
    if (setup[0] & 0x80) {
        wanted = setup[6] | (unsigned)setup[7] << 8;
        while (got < wanted) {
            n = 64;
            if (packet(AVR_IOCTL_USB_READ, data + got, &n) < 0) {
                put(NULL, 0, 0xFFFF);
                return;
            }
            got += n;
            if (n < 64)
                break;
        }
        n = 0;
        usb(AVR_IOCTL_USB_WRITE, 0, data, &n); /* status */
        run(50);
    } else {
        if (wanted && packet(AVR_IOCTL_USB_WRITE, data, &wanted) < 0) {
            put(NULL, 0, 0xFFFF);
            return;
        }
        run(200);
        n = 64;
        if (packet(AVR_IOCTL_USB_READ, data, &n) < 0) { /* status */
            put(NULL, 0, 0xFFFF);
            return;
        }
    }
    put(data, got, got);
}

static unsigned drain(uint8_t endpoint, uint8_t *to, unsigned have) {
    uint8_t data[64];
    unsigned n = 64;
    if (usb(AVR_IOCTL_USB_READ, endpoint, data, &n) != 0 || n == 0 || have + n > ROOM)
        return have;
    memcpy(to + have, data, n);
    return have + n;
}

static uint8_t pins[ROOM]; /* what came out of TX */
static unsigned on_pins;

static void from_pins(struct avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    if (on_pins < ROOM)
        pins[on_pins++] = (uint8_t)value;
}

static void through_pins(void) {
    static uint8_t in[ROOM], reports[ROOM];
    avr_irq_t *rx = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('1'), UART_IRQ_INPUT);
    unsigned ms = get16(), n = get16(), moved = 0, at, t;
    if (fread(in, 1, n, stdin) != n)
        exit(1);
    for (t = at = 0; t < ms * 1000; t += BYTE, at++) {
        if (at < n)
            avr_raise_irq(rx, in[at]);
        run(BYTE);
        if (at % 12 == 0)
            moved = drain(4, reports, moved);
    }
    put(pins, on_pins, on_pins);
    put(reports, moved, moved);
    on_pins = 0;
}

static void turn(void) {
    static uint8_t in[ROOM], serial[ROOM], reports[ROOM];
    unsigned ms = get16(), n = get16(), at = 0, said = 0, moved = 0, t;
    if (fread(in, 1, n, stdin) != n)
        exit(1);
    for (t = 0; t < ms * 1000; t += POLL) {
        unsigned size = n - at < 64 ? n - at : 64, left = size;
        if (size && usb(AVR_IOCTL_USB_WRITE, 2, in + at, &left) == 0)
            at += size;
        run(POLL);
        said = drain(3, serial, said);
        if (t % 1000 == 0) /* a mouse is asked every ms */
            moved = drain(4, reports, moved);
    }
    put(serial, said, said);
    put(reports, moved, moved);
}

int main(int argc, char **argv) {
    elf_firmware_t firmware = {0};
    int what;
    answers = fdopen(dup(1), "wb");
    dup2(2, 1);
    if (argc != 2 || elf_read_firmware(argv[1], &firmware) != 0)
        return 1;
    avr = avr_make_mcu_by_name("atmega32u4");
    if (avr == NULL || avr_init(avr) != 0)
        return 2;
    avr->log = LOG_ERROR;
    avr_load_firmware(avr, &firmware);
    avr->frequency = MHZ * 1000000;
    uint32_t flags = 0; /* not to simavr's own output */
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('1'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('1'), UART_IRQ_OUTPUT), from_pins, NULL);
    run(5000);
    while ((what = getchar()) != EOF) {
        if (what == 'C')
            control();
        else if (what == 'T')
            turn();
        else if (what == 'P')
            through_pins();
        else if (what == 'R') {
            unsigned n = 0;
            usb(AVR_IOCTL_USB_RESET, 0, NULL, &n);
            run(1000);
            put(NULL, 0, 0);
        }
        fflush(answers);
    }
    return 0;
}
