//! Parts of a refusal's help that several rows share, or that are decided by more than its values.

use crate::{ComponentId, MemberId, Name, State};

/// The command that starts a process by hand under a GCM that is there.
pub(super) fn by_hand(process: &Name) -> String {
    format!("trocar host --name {process} --gcm ADDR --listen 127.0.0.1:0 --plugins DIR")
}

/// The command that makes a component ACTIVE that stands so.
pub(super) fn activate(id: &ComponentId, state: State) -> String {
    match state {
        State::Created => {
            format!("Configure it (`trocar describe {id}` shows what is missing), then `trocar start {id}`.")
        }
        State::Ready | State::Active => format!("Start it: `trocar start {id}`."),
        State::Stopped(_) => format!("Resume it: `trocar resume {id}`."),
        State::Fault => format!("Reset it, then start it: `trocar reset {id}`, `trocar start {id}`."),
    }
}

/// The help for an argument, by the field it is in: only a command's argument has limits that its class
/// declares.
pub(super) fn argument_help(what: &str, field: &str) -> String {
    match field.split('.').next().unwrap_or_default() {
        "json" | "encoded" if MemberId::parse(what).is_ok() => {
            format!("Correct the value and ask again; `trocar describe {what}` shows units and limits.")
        }
        "execution" => {
            "Correct the setting and ask again; `trocar create --help` lists the settings of an execution."
                .into()
        }
        "options" => {
            "Correct the option and ask again; `trocar connect --help` lists the options of a connection."
                .into()
        }
        _ => "Correct it and ask again.".into(),
    }
}
