/* The AVR's protocol.c on this computer, for tests/output/serial/test_firmware.py: a board with two lines, and a mouse that adds
 * up its reports. It turns like the sketch's loop, one byte a turn. */
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "protocol.h"

typedef struct {
    sm_device device;
    sm_line lines[2];
    bool takes;   /* USB takes reports; otherwise they fail */
    bool by_hand; /* the caller passes them on */
    int64_t moved[SM_AXES];
    uint32_t reports;
    uint8_t buttons;
} board;

board *board_new(uint32_t now) {
    board *b = calloc(1, sizeof *b);
    int k;
    sm_start(&b->device, "test", now);
    for (k = 0; k < 2; k++)
        sm_start_line(&b->lines[k]);
    b->takes = b->device.usb_ready = true;
    return b;
}

void board_free(board *b) { free(b); }

void board_usb(board *b, bool ready, bool takes) {
    sm_set_usb(&b->device, ready);
    b->takes = takes;
}

void board_multipliers(board *b, uint8_t feature) { sm_set_multipliers(&b->device, feature); }

static void pass_on(board *b) {
    int k;
    if (b->by_hand || !sm_due(&b->device))
        return;
    if (!b->takes) {
        sm_not_passed_on(&b->device);
        return;
    }
    b->reports++;
    b->buttons = b->device.report[0];
    for (k = 0; k < SM_AXES; k++)
        b->moved[k] += (int16_t)(b->device.report[1 + 2 * k] | b->device.report[2 + 2 * k] << 8);
    sm_passed_on(&b->device);
}

/* Feeds `n` bytes to a line; the answers to both, one after the other, into `out`. Length of the answers. `step` bytes
 * come in each ms, 0: all at once. */
uint32_t board_turn(board *b, int line, const uint8_t *in, size_t n, uint32_t step, uint32_t now, uint8_t *out, size_t room) {
    size_t at = 0, made = 0, k;
    uint8_t length;
    sm_tick(&b->device, now);
    pass_on(b);
    for (; at < n; at++) {
        if (step && at && at % step == 0)
            sm_tick(&b->device, ++now);
        sm_take(&b->device, &b->lines[line], in[at], now);
        pass_on(b);
    }
    for (k = 0; k < 2; k++)
        while (room - made >= SM_LONGEST && (length = sm_answer(&b->device, &b->lines[k]))) {
            memcpy(out + made, b->device.frame, length);
            made += length;
        }
    return (uint32_t)made;
}

int64_t board_moved(const board *b, int axis) { return b->moved[axis]; }
uint32_t board_reports(const board *b) { return b->reports; }
uint8_t board_buttons(const board *b) { return b->buttons; }

/* For a real USB port: the caller fetches the report, sends it, and says what became of it. */
bool board_due(board *b, uint8_t *report) {
    b->by_hand = true;
    if (!sm_due(&b->device))
        return false;
    memcpy(report, b->device.report, SM_REPORT);
    return true;
}

void board_sent(board *b, bool taken) {
    if (taken)
        sm_passed_on(&b->device);
    else
        sm_not_passed_on(&b->device);
}
