//! Why Linux refuses to open a device, and what to do.

use rustix::io::Errno;

/// What an error of a serial port means.
pub fn serial_refusal(error: Errno) -> Option<&'static str> {
    Some(match error {
        Errno::NOENT | Errno::NOTDIR | Errno::NODEV | Errno::NXIO => {
            "there is no such serial port; plug it in, or give one that `facewire devices` lists"
        }
        Errno::ACCESS => "this user may not open it; add the user to the group dialout and log in again",
        // The permissions of files are refused with EACCES, the device rules of a unit or a container with EPERM.
        Errno::PERM => {
            "the rules of the service's unit or of the container exclude this device; add DeviceAllow= for its driver to \
             the unit (docs/reference.md, \"What the service may access\")"
        }
        Errno::BUSY => {
            "another program has it open; end that program (the service: `sudo systemctl stop facewire`), or give \
             another port"
        }
        Errno::NOTTY | Errno::ISDIR | Errno::INVAL => "not a serial port; give one that `facewire devices` lists",
        _ => return None,
    })
}

/// What an error of a chip on an I2C bus means.
pub fn i2c_refusal(error: Errno) -> Option<&'static str> {
    Some(match error {
        Errno::NOENT => {
            "there is no /dev/i2c bus of this number; switch I2C on, run `modprobe i2c-dev`, or give a number that \
             `ls /dev/i2c-*` shows"
        }
        Errno::ACCESS => "this user may not open the bus; add the user to the group i2c and log in again",
        Errno::PERM => {
            "the rules of the service's unit or of the container exclude I2C buses; install the unit's drop-in i2c.conf \
             (docs/reference.md, \"What the service may access\")"
        }
        Errno::BUSY => {
            "a driver of the kernel has the chip; remove its overlay from the system's settings, and restart"
        }
        // Adapters report an address that nobody acknowledges in these ways.
        Errno::NXIO | Errno::REMOTEIO | Errno::NODEV | Errno::IO => {
            "no chip answers; check its power, the wires SDA, SCL and ground, and its address with `i2cdetect -y`"
        }
        Errno::TIMEDOUT | Errno::AGAIN => {
            "the bus hangs; check that SDA and SCL are not connected to ground or to each other, and cut the board's \
             power for a moment"
        }
        _ => return None,
    })
}
