/* Frames in, frames and mouse reports out: the device's end of docs/protocol.md, as arithmetic without hardware.
 *
 * Plain C99 for the ATmega32U4 and for any computer that tests it. Nothing is allocated: the caller owns one
 * `sm_device` and one `sm_line` per serial line. Time comes in as milliseconds modulo 2^32.
 */
#ifndef SPHEREMOUSE_PROTOCOL_H
#define SPHEREMOUSE_PROTOCOL_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum {
    SM_VERSION = 1,
    SM_MOST = 64,         /* bytes of a frame's content, CRC included */
    SM_LONGEST = 54,      /* bytes of the longest answer as it goes over the line: IDENTITY */
    SM_AXES = 4,          /* x, y, wheel, pan */
    SM_REPORT = 9,        /* bytes of report 1 after its ID */
    SM_REPORT_ID = 1,
    SM_FEATURE_ID = 2,    /* one byte: the resolution multipliers */
    SM_STEP = 1200,       /* counts: 600 per radian x 20 rad/s x SM_SILENCE */
    SM_SILENCE = 100,     /* ms */
    SM_NOTCH = 120,       /* wheel and pan units of one notch */
    SM_DESCRIPTOR = 137,  /* bytes */
    SM_BOARD = 16
};

enum { SM_HELLO = 0x01, SM_MOTION = 0x02, SM_ASK_STATUS = 0x03, SM_STOP = 0x04 };
enum { SM_IDENTITY = 0x81, SM_ACK = 0x82, SM_STATUS = 0x83 };
enum { SM_RUNNING = 0x01, SM_TOO_LARGE = 0x02, SM_USB_READY = 0x04, SM_WHEEL_FINE = 0x08, SM_PAN_FINE = 0x10 };

/* One serial line: the frame that is coming in, and what has to be answered. */
typedef struct {
    uint8_t content[SM_MOST];
    uint8_t length;       /* of content so far */
    uint8_t left;         /* bytes until COBS's next code byte */
    bool begun;           /* a byte has come since the last 0x00 */
    bool too_long;
    uint32_t crc;
    uint16_t damaged;     /* frames */
    uint16_t sent;        /* number of the next frame from here */
    uint16_t last;        /* number of the last frame that came in this line's session */
    uint16_t answers;     /* number of the frame that the next ACK answers */
    uint32_t hello;       /* session that the next IDENTITY echoes */
    bool owes_identity, owes_status, owes_ack, step_too_large;
} sm_line;

/* The mouse: sessions, counters, buttons. */
typedef struct {
    bool running;
    bool taken;           /* a MOTION, in this session */
    bool usb_ready;       /* enumerated and awake */
    bool untold;          /* the computer has been away: what it knows of the buttons is not known */
    uint8_t fine;         /* resolution multipliers: bit 0 wheel, bit 1 pan */
    uint8_t buttons;      /* asked for */
    uint8_t reported;     /* buttons of the last report that USB took */
    uint8_t report[SM_REPORT];
    int16_t in_report[SM_AXES];
    const sm_line *line;  /* of the session */
    uint32_t session, last, first;
    uint16_t target[SM_AXES], passed[SM_AXES], last_passed[SM_AXES];
    int32_t notch[2];     /* 1/120 notches of wheel and pan that were in no report yet */
    uint16_t refused, lost, usb_errors;
    uint32_t frames, reports;
    uint32_t heard, second;  /* ms */
    uint32_t uptime;      /* s */
    bool trouble;         /* a frame was damaged, refused or lost; whoever shows it sets it back */
    char board[SM_BOARD];
    uint8_t frame[SM_LONGEST];  /* that `sm_answer` made */
} sm_device;

extern const uint8_t sm_descriptor[SM_DESCRIPTOR];  /* the HID report descriptor; in program memory on the AVR */

void sm_start(sm_device *device, const char *board, uint32_t now);
void sm_start_line(sm_line *line);

/* A byte has come. */
void sm_take(sm_device *device, sm_line *line, uint8_t byte, uint32_t now);
/* Time passes. */
void sm_tick(sm_device *device, uint32_t now);

/* Whether USB takes reports. A computer that was away is told the buttons anew when it is back. */
void sm_set_usb(sm_device *device, bool ready);
/* Whether `report` has to be sent now. One of the two below says what became of it. */
bool sm_due(sm_device *device);
void sm_passed_on(sm_device *device);
void sm_not_passed_on(sm_device *device);
/* The byte of the feature report; 0 after a USB reset. */
void sm_set_multipliers(sm_device *device, uint8_t feature);
uint8_t sm_multipliers(const sm_device *device);

/* Makes the answer that is due on a line, in `frame`; its length, or 0. */
uint8_t sm_answer(sm_device *device, sm_line *line);
bool sm_owes(const sm_line *line);

#ifdef __cplusplus
}
#endif
#endif
