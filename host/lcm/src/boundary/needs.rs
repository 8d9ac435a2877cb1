//! Entries of a class table that a description makes necessary.
//!
//! Invariant: the same check as the loader's for a manifest (`loader/table.rs`), for ports that came later;
//! the system interface, which stands last, and the taps are the host's own and need none.

use trocar_model::{CommandKind, Ports};
use trocar_plugin_api::abi::ClassTable;

use super::hot::entry;

/// The first entry that is null although a member of `ports` needs it, and the name of that member.
pub(super) fn lacking(table: *const ClassTable, ports: &Ports) -> Option<(&'static str, String)> {
    let own = &ports.provided[..ports.provided.len().saturating_sub(1)];
    let commands = || own.iter().flat_map(|p| p.commands.iter().map(move |c| (p, c)));
    let is_read = |kind| matches!(kind, CommandKind::Read | CommandKind::QualifiedRead);
    let member = |read: bool, what: &str| {
        commands()
            .find(|(_, c)| is_read(c.kind) == read)
            .map(|(p, c)| format!("{what} {}/{}", p.name, c.name))
    };
    let slot = || {
        let input = ports.inputs.first().map(|p| format!("the input {}", p.name));
        let output = || ports.own_outputs().next().map(|p| format!("the output {}", p.name));
        let mut functions = ports.required.iter().flat_map(|r| r.functions.iter().map(move |f| (r, f)));
        let mut events = own.iter().flat_map(|p| p.events.iter().map(move |e| (p, e)));
        input
            .or_else(output)
            .or_else(|| functions.next().map(|(r, f)| format!("the function {}/{}", r.name, f.name)))
            .or_else(|| events.next().map(|(p, e)| format!("the event {}/{}", p.name, e.name)))
    };
    let handler = || {
        let mut handlers = ports.required.iter().flat_map(|r| r.handlers.iter().map(move |h| (r, h)));
        handlers.next().map(|(r, h)| format!("the event handler {}/{}", r.name, h.name))
    };
    let null = |name, is_null: bool, what: &dyn Fn() -> Option<String>| {
        is_null.then(what).flatten().map(|what| (name, what))
    };
    null("bind", entry!(table, bind).is_none(), &slot)
        .or_else(|| null("command", entry!(table, command).is_none(), &|| member(false, "the command")))
        .or_else(|| null("read", entry!(table, read).is_none(), &|| member(true, "the read")))
        .or_else(|| null("on_event", entry!(table, on_event).is_none(), &handler))
}
