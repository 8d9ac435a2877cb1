//! The table of the convention, row by row, and what is said of a refusal.
#![allow(clippy::unwrap_used)]

use super::*;
use StateCommand::*;

const DISABLED: OperatingMode = OperatingMode::DISABLED;
const ENABLED: OperatingMode = OperatingMode::ENABLED;
const PAUSED: OperatingMode = OperatingMode::PAUSED;
const FAULT: OperatingMode = OperatingMode::FAULT;

fn state(mode: OperatingMode) -> OperatingStateMachine {
    OperatingStateMachine { mode, is_homed: true, is_busy: false }
}

#[test]
fn all_sixteen_pairs_of_the_crtk_table_go_where_it_says() {
    // Rows and columns as the convention prints them; None = invalid, the state stays.
    let table = [
        (DISABLED, [Some(ENABLED), Some(DISABLED), None, None]),
        (ENABLED, [Some(ENABLED), Some(DISABLED), Some(PAUSED), None]),
        (PAUSED, [None, Some(DISABLED), Some(PAUSED), Some(ENABLED)]),
        (FAULT, [Some(ENABLED), Some(DISABLED), None, None]),
    ];
    for (from, row) in table {
        for (command, to) in [Enable, Disable, Pause, Resume].into_iter().zip(row) {
            let after = state(from).after(command).ok();
            assert_eq!(after, to.map(state), "{from:?} {}", command.word());
        }
    }
}

#[test]
fn no_word_leads_to_fault_and_every_word_reads_back() {
    for (word, command) in STATE_COMMANDS {
        assert_eq!(StateCommand::parse(word), Ok(command));
        for from in [DISABLED, ENABLED, PAUSED] {
            assert_ne!(state(from).after(command).map(|to| to.mode), Ok(FAULT));
        }
    }
    let refused = StateCommand::parse("Enable").unwrap_err();
    assert_eq!(
        refused.to_string(),
        "`Enable` is no state command; CRTK has enable disable pause resume home unhome"
    );
}

#[test]
fn home_needs_enabled_and_unhome_needs_a_quiet_device() {
    assert!(state(ENABLED).after(Home).is_ok());
    for from in [DISABLED, PAUSED, FAULT] {
        assert!(state(from).after(Home).is_err());
    }
    assert_eq!(state(PAUSED).after(Unhome).map(|to| to.is_homed), Ok(false));
    assert!(OperatingStateMachine { is_busy: true, ..state(ENABLED) }.after(Unhome).is_err());
}

#[test]
fn a_refused_word_changes_nothing() {
    let mut paused = state(PAUSED);
    assert!(paused.command("enable").is_err() && paused.command("fly").is_err());
    assert_eq!(paused, state(PAUSED));
}

#[test]
fn a_fault_keeps_the_homing_and_ends_the_motion() {
    let mut device = state(ENABLED);
    device.move_begins();
    device.fault();
    assert_eq!((device.mode(), device.is_homed(), device.is_busy()), (FAULT, true, false));
    assert!(!device.is_ready());
}

#[test]
fn make_safe_pauses_an_enabled_device_and_leaves_the_others() {
    for (from, to) in [(ENABLED, PAUSED), (PAUSED, PAUSED), (DISABLED, DISABLED), (FAULT, FAULT)] {
        let mut device = state(from);
        device.made_safe();
        assert_eq!(device.mode(), to, "from {from:?}");
    }
}

#[test]
fn pausing_ends_the_motion_and_enabling_again_does_not() {
    let busy = OperatingStateMachine { is_busy: true, ..state(ENABLED) };
    assert!(!busy.after(Pause).unwrap().is_busy());
    assert!(busy.after(Enable).unwrap().is_busy());
}

#[test]
fn what_to_send_first_is_said() {
    let said = |m: OperatingStateMachine| m.require_ready().unwrap_err().to_string();
    assert_eq!(
        said(OperatingStateMachine::INITIAL),
        "the device is DISABLED: send state_command `enable` first"
    );
    assert_eq!(said(state(PAUSED)), "the device is PAUSED: send state_command `resume` first");
    let unhomed = OperatingStateMachine { is_homed: false, ..state(ENABLED) };
    assert_eq!(said(unhomed), "the device is not homed: send state_command `home` and wait for is_homed");
}

#[test]
fn a_long_reason_is_cut_between_characters() {
    let why = "µ".repeat(100);
    let told = state(FAULT).payload(Stamp::from_ns(7), Some(&why));
    assert_eq!(told.message.as_str(), "µ".repeat(64));
    assert_eq!((told.stamp.ns(), told.state), (7, FAULT));
}
