/* See protocol.h; the rules and their numbers are those of docs/protocol.md. */
#include "protocol.h"

#include <string.h>

#ifdef __AVR__
#include <avr/pgmspace.h>
#else
#define PROGMEM
#define pgm_read_dword(address) (*(address))
#endif

enum { LEAST = 8, VERSION_AT = 0, TYPE_AT = 1, NUMBER_AT = 2, BODY_AT = 4 };

static const uint8_t FIRMWARE[3] = {1, 0, 0};
static const uint8_t KIND = 2; /* AVR */
static const uint32_t COUNT = 0x3FFFFFFF;

const uint8_t sm_descriptor[SM_DESCRIPTOR] PROGMEM = {
    0x05, 0x01,                   /* Usage Page (Generic Desktop) */
    0x09, 0x02,                   /* Usage (Mouse) */
    0xa1, 0x01,                   /* Collection (Application) */
    0x09, 0x01,                   /*   Usage (Pointer) */
    0xa1, 0x00,                   /*   Collection (Physical) */
    0x85, SM_REPORT_ID,           /*     Report ID */
    0x05, 0x09,                   /*     Usage Page (Button) */
    0x19, 0x01, 0x29, 0x05,       /*       Usage 1 to 5 */
    0x15, 0x00, 0x25, 0x01,       /*       Logical 0 to 1 */
    0x75, 0x01, 0x95, 0x05,       /*       5 x 1 bit */
    0x81, 0x02,                   /*       Input (Data, Variable, Absolute) */
    0x75, 0x03, 0x95, 0x01,       /*       1 x 3 bits */
    0x81, 0x03,                   /*       Input (Constant) */
    0x05, 0x01,                   /*     Usage Page (Generic Desktop) */
    0x09, 0x30, 0x09, 0x31,       /*       Usage X, Y */
    0x16, 0x01, 0x80,             /*       Logical Minimum -32767 */
    0x26, 0xff, 0x7f,             /*       Logical Maximum 32767 */
    0x75, 0x10, 0x95, 0x02,       /*       2 x 16 bits */
    0x81, 0x06,                   /*       Input (Data, Variable, Relative) */
    0xa1, 0x02,                   /*     Collection (Logical): wheel and its multiplier */
    0x85, SM_FEATURE_ID,          /*       Report ID */
    0x09, 0x48,                   /*       Usage (Resolution Multiplier) */
    0x15, 0x00, 0x25, 0x01,       /*       Logical 0 to 1 */
    0x35, 0x01, 0x45, 0x78,       /*       Physical 1 to 120 */
    0x75, 0x02, 0x95, 0x01,       /*       1 x 2 bits */
    0xb1, 0x02,                   /*       Feature (Data, Variable, Absolute) */
    0x85, SM_REPORT_ID,           /*       Report ID */
    0x09, 0x38,                   /*       Usage (Wheel) */
    0x16, 0x01, 0x80,             /*       Logical Minimum -32767 */
    0x26, 0xff, 0x7f,             /*       Logical Maximum 32767 */
    0x35, 0x00, 0x45, 0x00,       /*       Physical as logical */
    0x75, 0x10,                   /*       1 x 16 bits */
    0x81, 0x06,                   /*       Input (Data, Variable, Relative) */
    0xc0,                         /*     End Collection */
    0xa1, 0x02,                   /*     Collection (Logical): pan and its multiplier */
    0x85, SM_FEATURE_ID,          /*       Report ID */
    0x09, 0x48,                   /*       Usage (Resolution Multiplier) */
    0x15, 0x00, 0x25, 0x01,       /*       Logical 0 to 1 */
    0x35, 0x01, 0x45, 0x78,       /*       Physical 1 to 120 */
    0x75, 0x02,                   /*       1 x 2 bits */
    0xb1, 0x02,                   /*       Feature (Data, Variable, Absolute) */
    0x35, 0x00, 0x45, 0x00,       /*       Physical as logical */
    0x75, 0x04,                   /*       1 x 4 bits */
    0xb1, 0x03,                   /*       Feature (Constant) */
    0x85, SM_REPORT_ID,           /*       Report ID */
    0x05, 0x0c,                   /*       Usage Page (Consumer) */
    0x0a, 0x38, 0x02,             /*       Usage (AC Pan) */
    0x16, 0x01, 0x80,             /*       Logical Minimum -32767 */
    0x26, 0xff, 0x7f,             /*       Logical Maximum 32767 */
    0x75, 0x10,                   /*       1 x 16 bits */
    0x81, 0x06,                   /*       Input (Data, Variable, Relative) */
    0xc0,                         /*     End Collection */
    0xc0,                         /*   End Collection */
    0xc0,                         /* End Collection */
};

/* ---- frames ---- */

static uint32_t crc_byte(uint32_t crc, uint8_t byte) {
    /* CRC-32 of the numbers 0 to 15, four bits a step: 64 bytes instead of 1024 */
    static const uint32_t TABLE[16] PROGMEM = {
        0x00000000, 0x1db71064, 0x3b6e20c8, 0x26d930ac, 0x76dc4190, 0x6b6b51f4, 0x4db26158, 0x5005713c,
        0xedb88320, 0xf00f9344, 0xd6d6a3e8, 0xcb61b38c, 0x9b64c2b0, 0x86d3d2d4, 0xa00ae278, 0xbdbdf21c,
    };
    crc ^= byte;
    crc = crc >> 4 ^ pgm_read_dword(&TABLE[crc & 15]);
    return crc >> 4 ^ pgm_read_dword(&TABLE[crc & 15]);
}

static uint16_t get16(const uint8_t *at) { return (uint16_t)(at[0] | (uint16_t)at[1] << 8); }

static uint32_t get32(const uint8_t *at) { return get16(at) | (uint32_t)get16(at + 2) << 16; }

static uint8_t *put16(uint8_t *at, uint16_t value) {
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

static uint8_t *put32(uint8_t *at, uint32_t value) { return put16(put16(at, (uint16_t)value), (uint16_t)(value >> 16)); }

static int16_t signed16(uint16_t difference) { return (int16_t)difference; }

static void next_frame(sm_line *line) {
    line->crc = 0xFFFFFFFF;
    line->length = line->left = 0;
    line->begun = line->too_long = false;
}

/* A byte of the frame's content. */
static void append(sm_line *line, uint8_t byte) {
    if (line->length == SM_MOST) {
        line->too_long = true;
        return;
    }
    line->content[line->length++] = byte;
    line->crc = crc_byte(line->crc, byte);
}

/* COBS: each code byte says how far it is to the next one, in whose place a 0 stood. */
static void append_coded(sm_line *line, uint8_t byte) {
    if (line->too_long)
        return;
    if (line->left) {
        line->left--;
        append(line, byte);
        return;
    }
    if (line->begun)
        append(line, 0);
    line->begun = true;
    line->left = (uint8_t)(byte - 1);
}

static bool whole(const sm_line *line) {
    return !line->too_long && line->left == 0 && line->length >= LEAST && line->crc == 0xDEBB20E3;
}

/* Header, CRC and COBS around the body, which is in its place in `frame`, one byte further than in the content. */
static uint8_t seal(sm_device *device, sm_line *line, uint8_t type, uint8_t *end) {
    uint8_t *frame = device->frame, *code = frame, *at;
    uint32_t crc = 0xFFFFFFFF;
    frame[1 + VERSION_AT] = SM_VERSION;
    frame[1 + TYPE_AT] = type;
    put16(frame + 1 + NUMBER_AT, line->sent++);
    for (at = frame + 1; at < end; at++)
        crc = crc_byte(crc, *at);
    end = put32(end, ~crc);
    for (at = frame + 1; at < end; at++)
        if (*at == 0) {
            *code = (uint8_t)(at - code);
            code = at;
        }
    *code = (uint8_t)(end - code);
    *end++ = 0;
    return (uint8_t)(end - frame);
}

/* ---- sessions ---- */

static void refuse(sm_device *device) {
    device->refused++;
    device->trouble = true;
}

static void damaged(sm_device *device, sm_line *line) {
    line->damaged++;
    if (line == device->line || !device->running) /* else it is the noise of an open pin */
        device->trouble = true;
}

static void owe_ack(sm_line *line, uint16_t number) {
    line->answers = number;
    line->step_too_large = false;
    line->owes_ack = true;
}

static void owe_identity(sm_line *line, uint32_t session) {
    line->hello = session;
    line->owes_identity = true;
}

static void end_session(sm_device *device) {
    if (!device->running)
        return;
    device->running = false;
    device->buttons = 0;
    memcpy(device->target, device->passed, sizeof device->target); /* what is due is dropped */
    if (!device->taken)
        return;
    device->last = device->session;
    memcpy(device->last_passed, device->passed, sizeof device->passed);
}

static void hello(sm_device *device, sm_line *line, uint16_t number, uint32_t now) {
    uint32_t session = get32(line->content + BODY_AT);
    if (device->running && session == device->session) {
        if (line != device->line) { /* the host has come back by another way */
            device->line = line;
            line->last = number;
        }
        owe_identity(line, session);
        return;
    }
    if (session == 0 || session == device->last) {
        refuse(device);
        return;
    }
    end_session(device);
    if (device->first == 0)
        device->first = session;
    device->session = session;
    memset(device->target, 0, sizeof device->target);
    memset(device->passed, 0, sizeof device->passed);
    device->line = line;
    device->heard = now;
    device->running = true;
    device->taken = false;
    line->last = number;
    line->owes_ack = false;
    owe_identity(line, session);
}

static void motion(sm_device *device, sm_line *line, bool newer, uint32_t now) {
    const uint8_t *body = line->content + BODY_AT;
    uint8_t k;
    owe_ack(line, get16(line->content + NUMBER_AT));
    if (!newer) {
        refuse(device);
        return;
    }
    for (k = 0; k < SM_AXES; k++) {
        int16_t step = signed16((uint16_t)(get16(body + 2 * k) - device->passed[k]));
        if (step > SM_STEP || step < -SM_STEP) {
            refuse(device);
            end_session(device);
            line->step_too_large = true;
            return;
        }
    }
    for (k = 0; k < SM_AXES; k++)
        device->target[k] = get16(body + 2 * k);
    device->buttons = body[8] & 0x1F;
    device->heard = now;
    device->taken = true;
}

/* Bytes of a frame's content, by its type; 0: no such type. */
static uint8_t length_of(uint8_t type) {
    switch (type) {
    case SM_HELLO: return LEAST + 4;
    case SM_MOTION: return LEAST + 9;
    case SM_ASK_STATUS:
    case SM_STOP: return LEAST;
    default: return 0;
    }
}

static void obey(sm_device *device, sm_line *line, uint32_t now) {
    uint8_t type = line->content[TYPE_AT];
    uint16_t number = get16(line->content + NUMBER_AT);
    bool newer = false, ours = type != SM_HELLO || get32(line->content + BODY_AT) == device->session;
    if (line->length != length_of(type) || line->content[VERSION_AT] != SM_VERSION) {
        damaged(device, line);
        if (type == SM_HELLO && line->length == length_of(type))
            owe_identity(line, 0); /* so that a host of another version learns ours */
        return;
    }
    device->frames = (device->frames + 1) & COUNT;
    if (device->running && ours && line == device->line) {
        uint16_t gap = (uint16_t)(number - line->last - 1);
        newer = signed16((uint16_t)(gap + 1)) > 0;
        if (newer) {
            line->last = number;
            device->lost = (uint16_t)(device->lost + gap);
            device->trouble = device->trouble || gap;
        }
    }
    switch (type) {
    case SM_HELLO: hello(device, line, number, now); break;
    case SM_MOTION: motion(device, line, newer, now); break;
    case SM_ASK_STATUS: line->owes_status = true; break;
    case SM_STOP:
        if (line == device->line)
            end_session(device);
        owe_ack(line, number);
        break;
    }
}

/* ---- what the caller sees ---- */

void sm_start(sm_device *device, const char *board, uint32_t now) {
    uint8_t k;
    memset(device, 0, sizeof *device);
    for (k = 0; k < SM_BOARD && board[k]; k++)
        device->board[k] = board[k];
    device->second = now;
}

void sm_start_line(sm_line *line) {
    memset(line, 0, sizeof *line);
    next_frame(line);
}

void sm_take(sm_device *device, sm_line *line, uint8_t byte, uint32_t now) {
    if (byte) {
        append_coded(line, byte);
        return;
    }
    if (whole(line))
        obey(device, line, now);
    else if (line->begun)
        damaged(device, line);
    next_frame(line);
}

void sm_tick(sm_device *device, uint32_t now) {
    if (device->running && now - device->heard >= SM_SILENCE)
        end_session(device);
    while (now - device->second >= 1000) {
        device->second += 1000;
        device->uptime = (device->uptime + 1) & COUNT;
    }
}

void sm_set_usb(sm_device *device, bool ready) {
    device->untold = device->untold || (!ready && device->reports);
    device->usb_ready = ready;
}

bool sm_due(sm_device *device) {
    uint8_t k, *at = device->report;
    bool send = device->untold || device->buttons != device->reported;
    if (!device->usb_ready)
        return false;
    *at++ = device->buttons;
    for (k = 0; k < SM_AXES; k++) {
        int16_t step = signed16((uint16_t)(device->target[k] - device->passed[k]));
        if (k >= 2 && !(device->fine >> (k - 2) & 1)) { /* whole notches only; the rest is kept */
            device->notch[k - 2] += step;
            device->passed[k] = device->target[k];
            step = (int16_t)(device->notch[k - 2] / SM_NOTCH);
        }
        device->in_report[k] = step;
        send = send || step;
        at = put16(at, (uint16_t)step);
    }
    return send;
}

void sm_passed_on(sm_device *device) {
    uint8_t k;
    device->untold = false;
    device->reported = device->report[0];
    device->reports = (device->reports + 1) & COUNT;
    for (k = 0; k < SM_AXES; k++)
        if (k >= 2 && !(device->fine >> (k - 2) & 1))
            device->notch[k - 2] -= (int32_t)device->in_report[k] * SM_NOTCH;
        else
            device->passed[k] = (uint16_t)(device->passed[k] + device->in_report[k]);
}

void sm_not_passed_on(sm_device *device) { device->usb_errors++; }

void sm_set_multipliers(sm_device *device, uint8_t feature) {
    device->fine = (uint8_t)((feature & 3 ? 1 : 0) | (feature >> 2 & 3 ? 2 : 0));
}

uint8_t sm_multipliers(const sm_device *device) {
    return (uint8_t)((device->fine & 1) | (device->fine & 2) << 1);
}

/* ---- answers ---- */

static uint8_t flags(const sm_device *device, const sm_line *line) {
    return (uint8_t)((device->running && line == device->line ? SM_RUNNING : 0) |
                     (device->usb_ready ? SM_USB_READY : 0) | (device->fine & 1 ? SM_WHEEL_FINE : 0) |
                     (device->fine & 2 ? SM_PAN_FINE : 0));
}

static uint8_t *put_counters(uint8_t *at, const uint16_t *counters) {
    uint8_t k;
    for (k = 0; k < SM_AXES; k++)
        at = put16(at, counters[k]);
    return at;
}

static uint8_t identity(sm_device *device, sm_line *line) {
    uint8_t *at = device->frame + 1 + BODY_AT;
    at = put32(at, line->hello);
    at = put32(at, device->last);
    at = put_counters(at, device->last_passed);
    at = put32(at, device->first);
    at = put16(at, SM_STEP);
    at = put16(at, SM_SILENCE);
    memcpy(at, FIRMWARE, 3);
    at[3] = KIND;
    memcpy(at + 4, device->board, SM_BOARD);
    return seal(device, line, SM_IDENTITY, at + 4 + SM_BOARD);
}

static uint8_t ack(sm_device *device, sm_line *line) {
    uint8_t *at = device->frame + 1 + BODY_AT;
    at = put16(at, line->answers);
    at = put_counters(at, device->passed);
    *at++ = (uint8_t)(flags(device, line) | (line->step_too_large ? SM_TOO_LARGE : 0));
    at = put16(at, device->refused);
    at = put16(at, device->lost);
    return seal(device, line, SM_ACK, at);
}

static uint8_t status(sm_device *device, sm_line *line) {
    uint8_t *at = device->frame + 1 + BODY_AT;
    at = put32(at, device->running ? device->session : 0);
    at = put32(at, device->uptime);
    at = put32(at, device->frames);
    at = put16(at, line->damaged);
    at = put16(at, device->refused);
    at = put16(at, device->lost);
    at = put32(at, device->reports);
    at = put16(at, device->usb_errors);
    *at++ = flags(device, line);
    *at++ = device->reported;
    return seal(device, line, SM_STATUS, at);
}

bool sm_owes(const sm_line *line) { return line->owes_identity || line->owes_status || line->owes_ack; }

uint8_t sm_answer(sm_device *device, sm_line *line) {
    if (line->owes_identity) {
        line->owes_identity = false;
        return identity(device, line);
    }
    if (line->owes_status) {
        line->owes_status = false;
        return status(device, line);
    }
    if (line->owes_ack) {
        line->owes_ack = false;
        return ack(device, line);
    }
    return 0;
}
