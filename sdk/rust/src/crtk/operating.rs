//! The CRTK operating state: what `state_command` does in each state, for any device.
//!
//! Invariant: [`OperatingStateMachine::after`] is the transition table of the convention, total over 4 states
//! × 6 words; no word leads to FAULT, only [`OperatingStateMachine::fault`] does. The convention leaves open
//! when `home` and `unhome` are allowed; it is decided here. Nothing allocates.

use crate::data::{OperatingMode, OperatingState};
use crate::values::{Stamp, Text};
use core::fmt::{self, Display, Write};

/// The words `state_command` takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StateCommand {
    /// To ENABLED; retries after a fault.
    Enable,
    /// To DISABLED.
    Disable,
    /// To PAUSED.
    Pause,
    /// From PAUSED back to ENABLED.
    Resume,
    /// Find the home position; then the device is homed.
    Home,
    /// Forget the homing.
    Unhome,
}

/// All words.
pub const STATE_COMMANDS: [(&str, StateCommand); 6] = [
    ("enable", StateCommand::Enable),
    ("disable", StateCommand::Disable),
    ("pause", StateCommand::Pause),
    ("resume", StateCommand::Resume),
    ("home", StateCommand::Home),
    ("unhome", StateCommand::Unhome),
];

impl StateCommand {
    /// Reads the word of a command.
    ///
    /// # Errors
    /// A word that is no CRTK state command.
    pub fn parse(word: &str) -> Result<Self, Refused> {
        let found = STATE_COMMANDS.iter().find(|(name, _)| *name == word);
        found.map(|(_, command)| *command).ok_or(Refused::NoSuchWord { word: Text::new(word) })
    }

    /// The word of the command, such as "enable".
    pub fn word(self) -> &'static str {
        STATE_COMMANDS.iter().find(|(_, command)| *command == self).map_or("", |(word, _)| *word)
    }
}

/// Operating state of one device. A plain value: hold it in the driver, publish it with [`Self::payload`].
///
/// ```
/// use trocar_sdk::{crtk::{OperatingStateMachine, StateCommand}, data::OperatingMode};
/// let mut state = OperatingStateMachine::default();
/// assert_eq!(state.command("enable"), Ok(StateCommand::Enable));
/// assert_eq!(state.command("home"), Ok(StateCommand::Home));
/// state.move_begins();
/// state.homed();
/// assert!(state.require_ready().is_ok());
/// state.fault();
/// let refused = state.command("resume").unwrap_err();
/// assert_eq!(
///     refused.to_string(),
///     "`resume` is not allowed while the device is FAULT; allowed: enable disable unhome"
/// );
/// assert_eq!(state.mode(), OperatingMode::FAULT);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OperatingStateMachine {
    mode: OperatingMode,
    is_homed: bool,
    is_busy: bool,
}

impl OperatingStateMachine {
    /// State after power-up: DISABLED, not homed.
    pub const INITIAL: Self =
        OperatingStateMachine { mode: OperatingMode::DISABLED, is_homed: false, is_busy: false };

    /// The state now.
    pub const fn mode(self) -> OperatingMode {
        self.mode
    }

    /// The positions are referenced.
    pub const fn is_homed(self) -> bool {
        self.is_homed
    }

    /// A `move_*` or the homing is running.
    pub const fn is_busy(self) -> bool {
        self.is_busy
    }

    /// Motions are taken: enabled and homed.
    pub fn is_ready(self) -> bool {
        self.mode == OperatingMode::ENABLED && self.is_homed
    }

    /// For the first line of every motion command.
    ///
    /// # Errors
    /// Not enabled or not homed; the text says what to send first.
    pub fn require_ready(self) -> Result<(), NotReady> {
        if self.is_ready() { Ok(()) } else { Err(NotReady { mode: self.mode }) }
    }

    /// Takes a word of `state_command`; acting on it is the device's.
    ///
    /// # Errors
    /// An unknown word, or one that the table does not allow now; the state stays.
    pub fn command(&mut self, word: &str) -> Result<StateCommand, Refused> {
        let command = StateCommand::parse(word)?;
        *self = self.after(command)?;
        Ok(command)
    }

    /// Returns the state after a command. `home` changes nothing by itself: the device says
    /// [`Self::move_begins`] when it sets off and [`Self::homed`] when it arrives.
    ///
    /// # Errors
    /// The pair is marked invalid in the CRTK table.
    pub fn after(self, command: StateCommand) -> Result<Self, Refused> {
        use StateCommand::*;
        const DISABLED: OperatingMode = OperatingMode::DISABLED;
        const ENABLED: OperatingMode = OperatingMode::ENABLED;
        const PAUSED: OperatingMode = OperatingMode::PAUSED;
        const FAULT: OperatingMode = OperatingMode::FAULT;
        let to = match (self.mode, command) {
            (DISABLED | ENABLED | FAULT, Enable) | (PAUSED, Resume) => ENABLED,
            (_, Disable) => DISABLED,
            (ENABLED | PAUSED, Pause) => PAUSED,
            (ENABLED, Home) => return Ok(self),
            (_, Unhome) if !self.is_busy => return Ok(OperatingStateMachine { is_homed: false, ..self }),
            _ => return Err(Refused::NotNow { from: self, command }),
        };
        Ok(OperatingStateMachine { mode: to, is_busy: self.is_busy && to == self.mode, ..self })
    }

    /// A `move_*` or the homing sets off.
    pub fn move_begins(&mut self) {
        self.is_busy = true;
    }

    /// The motion is over: arrived, pre-empted or stopped.
    pub fn move_ends(&mut self) {
        self.is_busy = false;
    }

    /// The homing has arrived.
    pub fn homed(&mut self) {
        (self.is_homed, self.is_busy) = (true, false);
    }

    /// The device failed: limit, following error, sensor lost. The homing is kept.
    pub fn fault(&mut self) {
        (self.mode, self.is_busy) = (OperatingMode::FAULT, false);
    }

    /// `make_safe` was called: an enabled device is PAUSED, so that only `resume` lets it move again.
    pub fn made_safe(&mut self) {
        self.is_busy = false;
        if let Ok(paused) = self.after(StateCommand::Pause) {
            *self = paused;
        }
    }

    /// The payload of `operating_state`, with the reason of a fault cut to 128 bytes.
    pub fn payload(self, stamp: Stamp, why: Option<&dyn Display>) -> OperatingState {
        OperatingState {
            stamp,
            state: self.mode,
            is_homed: self.is_homed.into(),
            is_busy: self.is_busy.into(),
            reserved: [0; 2],
            message: why.map_or_else(Text::default, line),
        }
    }
}

/// Writes `what` on the stack, cut between characters.
fn line(what: &dyn Display) -> Text<128> {
    struct Line {
        bytes: [u8; 128],
        len: usize,
    }
    impl Write for Line {
        fn write_str(&mut self, part: &str) -> fmt::Result {
            let mut end = part.len().min(self.bytes.len() - self.len);
            while !part.is_char_boundary(end) {
                end -= 1;
            }
            self.bytes[self.len..self.len + end].copy_from_slice(&part.as_bytes()[..end]);
            self.len += end;
            if end == part.len() { Ok(()) } else { Err(fmt::Error) }
        }
    }
    let mut line = Line { bytes: [0; 128], len: 0 };
    // A cut sentence is still worth showing.
    let _ = write!(line, "{what}");
    Text::new(core::str::from_utf8(&line.bytes[..line.len]).unwrap_or(""))
}

/// Why a `state_command` changed nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refused {
    /// No CRTK state command.
    NoSuchWord {
        /// The word that came, as much of it as fits.
        word: Text<32>,
    },
    /// Not allowed in this state.
    NotNow {
        /// The state in which the command came.
        from: OperatingStateMachine,
        /// The command that is refused.
        command: StateCommand,
    },
}

impl Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Refused::NoSuchWord { word } => {
                write!(f, "`{word}` is no state command; CRTK has")?;
                STATE_COMMANDS.iter().try_for_each(|(word, _)| write!(f, " {word}"))
            }
            Refused::NotNow { from, command } => {
                let busy = if from.is_busy { " and busy" } else { "" };
                write!(
                    f,
                    "`{}` is not allowed while the device is {:?}{busy}; allowed:",
                    command.word(),
                    from.mode
                )?;
                let mut allowed = STATE_COMMANDS.iter().filter(|(_, command)| from.after(*command).is_ok());
                allowed.try_for_each(|(word, _)| write!(f, " {word}"))
            }
        }
    }
}

impl std::error::Error for Refused {}

/// A motion was refused: the device is not enabled and homed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotReady {
    /// Its state.
    pub mode: OperatingMode,
}

impl Display for NotReady {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.mode {
            OperatingMode::ENABLED => {
                write!(f, "the device is not homed: send state_command `home` and wait for is_homed")
            }
            mode => {
                let word = if mode == OperatingMode::PAUSED { "resume" } else { "enable" };
                write!(f, "the device is {mode:?}: send state_command `{word}` first")
            }
        }
    }
}

impl std::error::Error for NotReady {}

#[cfg(test)]
#[path = "operating_tests.rs"]
mod tests;
