// The USB side: an interface of its own beside the core's serial port, with the report descriptor of protocol.c.
// The core's HID library will not do: it takes no feature reports, and those carry the resolution multipliers.
#ifndef SPHEREMOUSE_MOUSE_H
#define SPHEREMOUSE_MOUSE_H

#include <Arduino.h>
#include <PluggableUSB.h>

#include "protocol.h"

class Mouse : public PluggableUSBModule {
  public:
    Mouse();
    bool ready() const;  // the computer has enumerated the board and is awake
    bool room() const;   // a report can be handed over without waiting
    bool send(const uint8_t *report);  // SM_REPORT bytes
    uint8_t multipliers() const { return multipliers_; }

  protected:
    int getInterface(uint8_t *count) override;
    int getDescriptor(USBSetup &setup) override;
    bool setup(USBSetup &setup) override;
    uint8_t getShortName(char *name) override;

  private:
    uint8_t endpoint_type_[1];
    volatile uint8_t multipliers_;  // as last written by the computer; the functions above run in interrupts
    uint8_t idle_, protocol_;
};

#endif
