// The trackball that is a microcontroller (ATmega32U4: Arduino Leonardo, Micro, SparkFun Pro Micro): serial in, USB
// mouse out, as docs/protocol.md says. Two lines are served alike: the serial port of the USB cable, and the pins RX (0)
// and TX (1) at 115200 baud for a host on another computer.
//
// LED RX says what the Pico's LED says. Dark: no computer takes this for a mouse, or it sleeps. Slow blinking: waits for
// a session. Steady: a session runs. Flicker: frames were damaged, refused or lost. LED TX is the core's own: USB sends.
//
// No watchdog: the core uses it to reach the boot loader when a new sketch is loaded.
#include "mouse.h"
#include "protocol.h"

namespace {

const uint8_t AT_ONCE = 64;  // bytes read from a line before the mouse has its turn
const uint16_t TROUBLE = 300;  // ms that the LED flickers

Mouse mouse;
sm_device device;
sm_line usb, pins;
uint32_t trouble_at;  // ms
bool troubled;

// Whether an answer can be written without waiting. An empty bank of the endpoint: the core's flush in the SOF
// interrupt, which sends what a bank holds, cannot come between.
bool usb_takes() { return Serial.dtr() && USB_SendSpace(CDC_TX) == USB_EP_SIZE; }

bool pins_take() { return Serial1.availableForWrite() >= SM_LONGEST; }

void usb_write(uint8_t length) {
    Serial.write(device.frame, length);
    noInterrupts();  // the core's flush selects an endpoint and must not be interrupted
    Serial.flush();
    interrupts();
}

void read(sm_line &line, Stream &from, uint32_t now) {
    for (uint8_t n = AT_ONCE; n && from.available() > 0; n--)
        sm_take(&device, &line, from.read(), now);
}

// An ACK waits until nothing more has come, so that it is one for many where the board is slow.
bool answers(const sm_line &line, Stream &from) {
    return line.owes_identity || line.owes_status || (line.owes_ack && from.available() <= 0);
}

void pass_on() {
    sm_set_usb(&device, mouse.ready());
    sm_set_multipliers(&device, mouse.multipliers());
    if (!device.usb_ready || !mouse.room() || !sm_due(&device))
        return;
    if (mouse.send(device.report))
        sm_passed_on(&device);
    else
        sm_not_passed_on(&device);
}

// Written in every turn: the core's interrupts light this LED as well.
void show(uint32_t now) {
    if (device.trouble) {
        device.trouble = false;
        trouble_at = now;
        troubled = true;
    }
    troubled = troubled && now - trouble_at < TROUBLE;
    const bool lit = device.usb_ready && (troubled ? now & 32 : device.running || now & 512);
    if (lit) {
        RXLED1;
    } else {
        RXLED0;
    }
}

}  // namespace

void setup() {
    sm_start(&device, "ATmega32U4", millis());
    sm_start_line(&usb);
    sm_start_line(&pins);
    Serial.begin(115200);
    Serial1.begin(115200);
    pinMode(0, INPUT_PULLUP);  // quiet where nothing is connected
}

void loop() {
    const uint32_t now = millis();
    read(usb, Serial, now);
    read(pins, Serial1, now);
    sm_tick(&device, now);
    pass_on();
    if (answers(usb, Serial) && usb_takes())
        usb_write(sm_answer(&device, &usb));
    if (answers(pins, Serial1) && pins_take()) {
        const uint8_t length = sm_answer(&device, &pins);
        Serial1.write(device.frame, length);
    }
    show(now);
}
