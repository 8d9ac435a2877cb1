//! The CRTK operating state: what `state_command` does in each state.
//!
//! Invariant: `Operating::apply` is the transition table of the CRTK convention, total over 4 states × 4 state commands;
//! no command leads to FAULT, only [`Operating::fault`] does. Source: Su et al., "Collaborative Robotics Toolkit
//! (CRTK): Open Software Framework for Surgical Robotics Research", IRC 2020, and its API document. When `home` and
//! `unhome` are allowed is left open there and decided here.

use std::fmt;

/// CRTK meta-state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Motors off; motions refused.
    Disabled,
    /// Motions taken, once homed.
    Enabled,
    /// Holds its position; motions refused until `resume`.
    Paused,
    /// Stopped by a fault; `enable` or `disable` try again.
    Fault,
}

impl State {
    /// The state's name in CRTK spelling.
    pub fn name(self) -> &'static str {
        match self {
            State::Disabled => "DISABLED",
            State::Enabled => "ENABLED",
            State::Paused => "PAUSED",
            State::Fault => "FAULT",
        }
    }
}

/// The words `state_command` takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// To ENABLED; retries after a fault.
    Enable,
    /// To DISABLED.
    Disable,
    /// To PAUSED.
    Pause,
    /// From PAUSED back to ENABLED.
    Resume,
    /// Move to the home position; then the arm is homed.
    Home,
    /// Forget the homing.
    Unhome,
}

/// All commands with their words.
pub const COMMANDS: [(&str, Command); 6] = [
    ("enable", Command::Enable),
    ("disable", Command::Disable),
    ("pause", Command::Pause),
    ("resume", Command::Resume),
    ("home", Command::Home),
    ("unhome", Command::Unhome),
];

impl Command {
    /// Reads a word.
    ///
    /// # Errors
    /// A word that is no CRTK state command.
    pub fn parse(word: &str) -> Result<Self, Refused> {
        COMMANDS
            .iter()
            .find(|(name, _)| *name == word)
            .map(|(_, command)| *command)
            .ok_or(Refused::NoSuchWord)
    }

    /// The command's word.
    pub fn word(self) -> &'static str {
        COMMANDS.iter().find(|(_, command)| *command == self).map_or("", |(word, _)| *word)
    }
}

/// The operating state an arm shows (CRTK `operating_state`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Operating {
    /// Meta-state.
    pub state: State,
    /// The joint positions are referenced.
    pub is_homed: bool,
    /// A `move_*` or the homing is running.
    pub is_busy: bool,
}

impl Operating {
    /// As after power-up: DISABLED, not homed.
    pub const INITIAL: Operating = Operating { state: State::Disabled, is_homed: false, is_busy: false };

    /// Motions are taken: enabled and homed.
    pub fn is_ready(self) -> bool {
        self.state == State::Enabled && self.is_homed
    }

    /// The operating state after `command`. `home` changes no flag here: the arm sets `is_busy` when it starts and
    /// `is_homed` when it arrives.
    ///
    /// # Errors
    /// The pair is marked invalid in the CRTK table; the state stays.
    pub fn apply(self, command: Command) -> Result<Operating, Refused> {
        use {Command::*, State::*};
        let to = match (self.state, command) {
            (Disabled | Enabled | Fault, Enable) | (Paused, Resume) => Enabled,
            (_, Disable) => Disabled,
            (Enabled | Paused, Pause) => Paused,
            (Enabled, Home) => return Ok(self),
            (_, Unhome) if !self.is_busy => return Ok(Operating { is_homed: false, ..self }),
            (Paused, Enable) | (_, Pause | Resume | Home | Unhome) => {
                return Err(Refused::Invalid { from: self, command });
            }
        };
        Ok(Operating { state: to, is_busy: self.is_busy && to == self.state, ..self })
    }

    /// The operating state after a device fault.
    pub fn fault(self) -> Operating {
        Operating { state: State::Fault, is_busy: false, ..self }
    }
}

/// Why a `state_command` changed nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// The word is not a CRTK state command.
    NoSuchWord,
    /// Not allowed in this state.
    Invalid {
        /// The state it was asked in.
        from: Operating,
        /// What was asked.
        command: Command,
    },
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Refused::NoSuchWord => {
                write!(f, "not a state command; CRTK has {}", COMMANDS.map(|(word, _)| word).join(", "))
            }
            Refused::Invalid { from, command } => {
                let (word, state, busy) =
                    (command.word(), from.state.name(), if from.is_busy { " and busy" } else { "" });
                write!(f, "`{word}` is not allowed while the arm is {state}{busy}; allowed:")?;
                COMMANDS
                    .iter()
                    .filter(|(_, c)| from.apply(*c).is_ok())
                    .try_for_each(|(w, _)| write!(f, " {w}"))
            }
        }
    }
}

impl std::error::Error for Refused {}

#[cfg(test)]
mod tests {
    use super::*;
    use {Command::*, State::*};

    fn state(state: State) -> Operating {
        Operating { state, is_homed: true, is_busy: false }
    }

    #[test]
    fn all_sixteen_pairs_of_the_crtk_table_go_where_it_says() {
        // Rows and columns as the convention prints them; None = invalid, the state stays.
        let table = [
            (Disabled, [Some(Enabled), Some(Disabled), None, None]),
            (Enabled, [Some(Enabled), Some(Disabled), Some(Paused), None]),
            (Paused, [None, Some(Disabled), Some(Paused), Some(Enabled)]),
            (Fault, [Some(Enabled), Some(Disabled), None, None]),
        ];
        for (from, row) in table {
            for (command, to) in [Enable, Disable, Pause, Resume].into_iter().zip(row) {
                assert_eq!(
                    state(from).apply(command).ok(),
                    to.map(state),
                    "{} {}",
                    from.name(),
                    command.word()
                );
            }
        }
    }

    #[test]
    fn no_command_leads_to_fault_and_every_word_reads_back() {
        for (word, command) in COMMANDS {
            assert_eq!(Command::parse(word), Ok(command));
            for from in [Disabled, Enabled, Paused] {
                assert_ne!(state(from).apply(command).map(|to| to.state), Ok(Fault));
            }
        }
        assert_eq!(Command::parse("Enable"), Err(Refused::NoSuchWord));
    }

    #[test]
    fn home_needs_enabled_and_unhome_needs_a_quiet_arm() {
        assert!(state(Enabled).apply(Home).is_ok());
        for from in [Disabled, Paused, Fault] {
            assert!(state(from).apply(Home).is_err());
        }
        assert_eq!(state(Paused).apply(Unhome).map(|to| to.is_homed), Ok(false));
        assert!(Operating { is_busy: true, ..state(Enabled) }.apply(Unhome).is_err());
    }

    #[test]
    fn a_fault_keeps_the_homing_and_ends_the_motion() {
        let moving = Operating { is_busy: true, ..state(Enabled) };
        assert_eq!(moving.fault(), Operating { state: Fault, is_homed: true, is_busy: false });
        assert!(!moving.fault().is_ready());
    }

    #[test]
    fn a_refusal_names_state_and_command_and_lists_what_is_allowed() {
        let refused = state(Disabled).apply(Resume).expect_err("nothing to resume");
        assert_eq!(
            refused.to_string(),
            "`resume` is not allowed while the arm is DISABLED; allowed: enable disable unhome"
        );
    }
}
