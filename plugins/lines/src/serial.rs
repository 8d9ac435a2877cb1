//! A serial line, opened raw: eight bits, no parity, one stop bit, no flow control.
//!
//! Invariant: the port is this component's alone while it is open, and its speed is what was asked for, or it
//! is not taken.

use std::fs::File;

use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::termios::{ControlModes, OptionalActions, ioctl_tiocexcl, tcgetattr, tcsetattr};

/// Opens a port for reading and writing without waiting.
///
/// # Errors
/// A sentence with what to do.
pub(crate) fn open(port: &str, baud: u32) -> Result<File, String> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let file = rustix::fs::open(port, flags, Mode::empty()).map_err(|why| {
        let what = match why {
            Errno::NOENT => "is not there: is the device plugged in?",
            Errno::ACCESS => {
                "may not be opened by this user: is the user in the group of the port, often `dialout`?"
            }
            Errno::BUSY => "is in use by another program: end that one",
            _ => "cannot be opened",
        };
        format!("serial: {port} {what} ({why})")
    })?;
    let refused = |why: Errno| match why {
        Errno::NOTTY => format!("serial: {port} is not a serial line"),
        why => format!("serial: {port} does not take {baud} Bd, 8N1: {why}; give a speed that it has"),
    };
    let mut modes = tcgetattr(&file).map_err(refused)?;
    modes.make_raw();
    modes
        .control_modes
        .remove(ControlModes::CSIZE | ControlModes::PARENB | ControlModes::CSTOPB | ControlModes::CRTSCTS);
    modes.control_modes.insert(ControlModes::CS8 | ControlModes::CREAD | ControlModes::CLOCAL);
    modes.set_speed(baud).map_err(refused)?;
    tcsetattr(&file, OptionalActions::Now, &modes).map_err(refused)?;
    // A driver takes what it can and says nothing.
    let got = tcgetattr(&file).map_err(refused)?.output_speed();
    if got.abs_diff(baud) > baud / 20 {
        return Err(format!("serial: {port} runs at {got} Bd, not at {baud} Bd: give a speed that it has"));
    }
    ioctl_tiocexcl(&file).map_err(refused)?;
    Ok(File::from(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_serial_line_or_not_there_is_refused_with_what_to_do() {
        let missing = open("/dev/no-such-port", 9600).unwrap_err();
        assert!(
            missing.starts_with("serial: /dev/no-such-port is not there: is the device plugged in?"),
            "{missing}"
        );
        assert_eq!(open("/dev/null", 9600).unwrap_err(), "serial: /dev/null is not a serial line");
    }
}
