// See mouse.h. USB: HID 1.11, chapters 6.2 (descriptors) and 7.2 (requests).
#include "mouse.h"

namespace {

const uint8_t HID_CLASS = 3, HID_TYPE = 0x21, REPORT_TYPE = 0x22;
const uint8_t GET_REPORT = 1, GET_IDLE = 2, GET_PROTOCOL = 3, SET_REPORT = 9, SET_IDLE = 10, SET_PROTOCOL = 11;
const uint8_t FEATURE = 3;
const char SERIAL_NUMBER[] = "spheremouse";  // by which the host finds the board, whoever has compiled this

struct HidDescriptor {
    uint8_t length, type;
    uint16_t version;
    uint8_t country, descriptors, descriptor_type;
    uint16_t descriptor_length;
} __attribute__((packed));

struct Interface {
    InterfaceDescriptor interface;
    HidDescriptor hid;
    EndpointDescriptor in;
} __attribute__((packed));

}  // namespace

Mouse::Mouse() : PluggableUSBModule(1, 1, endpoint_type_), multipliers_(0), idle_(0), protocol_(1) {
    endpoint_type_[0] = EP_TYPE_INTERRUPT_IN;
    PluggableUSB().plug(this);
}

bool Mouse::ready() const { return USBDevice.configured() && !USBDevice.isSuspended(); }

bool Mouse::room() const { return USB_SendSpace(pluggedEndpoint) == USB_EP_SIZE; }  // one of two banks is empty

bool Mouse::send(const uint8_t *report) {
    uint8_t packet[1 + SM_REPORT];
    packet[0] = SM_REPORT_ID;
    memcpy(packet + 1, report, SM_REPORT);
    return USB_Send(pluggedEndpoint | TRANSFER_RELEASE, packet, sizeof packet) == sizeof packet;
}

int Mouse::getInterface(uint8_t *count) {
    *count += 1;
    const Interface all = {
        D_INTERFACE(pluggedInterface, 1, HID_CLASS, 0, 0),
        {sizeof(HidDescriptor), HID_TYPE, 0x0111, 0, 1, REPORT_TYPE, SM_DESCRIPTOR},
        D_ENDPOINT(USB_ENDPOINT_IN(pluggedEndpoint), USB_ENDPOINT_TYPE_INTERRUPT, USB_EP_SIZE, 1),  // every 1 ms
    };
    return USB_SendControl(0, &all, sizeof all);
}

int Mouse::getDescriptor(USBSetup &setup) {
    if (setup.bmRequestType != REQUEST_DEVICETOHOST_STANDARD_INTERFACE || setup.wValueH != REPORT_TYPE ||
        setup.wIndex != pluggedInterface)
        return 0;
    multipliers_ = 0;  // this is read once after each USB reset, before anything is set
    protocol_ = 1;
    return USB_SendControl(TRANSFER_PGM, sm_descriptor, SM_DESCRIPTOR);
}

bool Mouse::setup(USBSetup &setup) {
    if (setup.wIndex != pluggedInterface)
        return false;
    const bool feature = setup.wValueH == FEATURE && setup.wValueL == SM_FEATURE_ID;
    if (setup.bmRequestType == REQUEST_DEVICETOHOST_CLASS_INTERFACE) {
        const uint8_t report[2] = {SM_FEATURE_ID, multipliers_};
        switch (setup.bRequest) {
        case GET_REPORT: return feature && USB_SendControl(0, report, sizeof report) >= 0;
        case GET_IDLE: return USB_SendControl(0, &idle_, 1) >= 0;
        case GET_PROTOCOL: return USB_SendControl(0, &protocol_, 1) >= 0;
        }
    }
    if (setup.bmRequestType == REQUEST_HOSTTODEVICE_CLASS_INTERFACE) {
        uint8_t report[2];
        switch (setup.bRequest) {
        case SET_REPORT:
            if (!feature || setup.wLength != sizeof report)
                return false;
            USB_RecvControl(report, sizeof report);
            multipliers_ = report[1];
            return true;
        case SET_IDLE: idle_ = setup.wValueH; return true;
        case SET_PROTOCOL: protocol_ = setup.wValueL; return true;
        }
    }
    return false;
}

uint8_t Mouse::getShortName(char *name) {
    memcpy(name, SERIAL_NUMBER, sizeof SERIAL_NUMBER - 1);
    return sizeof SERIAL_NUMBER - 1;
}
