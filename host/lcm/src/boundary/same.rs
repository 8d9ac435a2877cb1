//! Parts that stay the same from one description of a component to the next: ports, and members of
//! interfaces.
//!
//! Invariant: a member is found by the name of its interface and its own name. It is the same only where
//! nothing a peer relies on differs; its documentation may differ.

use trocar_model::{Command, Event, Function, Handler, PortType, Ports, Provided};

fn same_type(a: &PortType, b: &PortType) -> bool {
    match (a, b) {
        (PortType::Plain(a), PortType::Plain(b)) => a.same(b),
        (PortType::Any, PortType::Any) => true,
        (
            PortType::Frame { header, format, max_bytes },
            PortType::Frame { header: h, format: f, max_bytes: m },
        ) => header.same(h) && format == f && max_bytes == m,
        _ => false,
    }
}

/// Tells whether two descriptions have the same output: name and type; the documentation may differ.
pub(crate) fn same_output(a: &trocar_model::Output, b: &trocar_model::Output) -> bool {
    a.name == b.name && same_type(&a.ty, &b.ty)
}

/// As [`same_output`]. An input that becomes required stays, too.
pub(crate) fn same_input(a: &trocar_model::Input, b: &trocar_model::Input) -> bool {
    a.name == b.name && same_type(&a.ty, &b.ty)
}

/// Tells whether two required interfaces are the same: name and members, in the same order.
pub(crate) fn same_required(a: &trocar_model::Required, b: &trocar_model::Required) -> bool {
    let plain = |r: &trocar_model::Required| {
        let mut r = r.clone();
        r.doc.clear();
        r.functions.iter_mut().for_each(|f| f.doc.clear());
        r.handlers.iter_mut().for_each(|h| h.doc.clear());
        r
    };
    plain(a) == plain(b)
}

/// Tells whether two provided interfaces are the same: name and members, in the same order.
pub(crate) fn same_provided(a: &trocar_model::Provided, b: &trocar_model::Provided) -> bool {
    let plain = |p: &trocar_model::Provided| {
        let mut p = p.clone();
        p.doc.clear();
        p.events.iter_mut().for_each(|e| e.doc.clear());
        for command in &mut p.commands {
            command.doc.clear();
            if let Some(arg) = &mut command.arg {
                arg.doc.clear();
            }
        }
        p
    };
    plain(a) == plain(b)
}

/// Position of the same command in `old`.
pub(crate) fn command(old: &Ports, interface: &Provided, new: &Command) -> Option<usize> {
    let plain = |command: &Command| {
        let mut command = command.clone();
        command.doc.clear();
        if let Some(arg) = &mut command.arg {
            arg.doc.clear();
        }
        command
    };
    let i = provided(old, interface)?;
    let at = old.provided[i].commands.iter().position(|o| plain(o) == plain(new))?;
    Some(old.first_command(i) + at)
}

/// Position of the same event in `old`.
pub(super) fn event(old: &Ports, interface: &Provided, new: &Event) -> Option<usize> {
    let plain = |event: &Event| Event { doc: String::new(), ..event.clone() };
    let i = provided(old, interface)?;
    let at = old.provided[i].events.iter().position(|o| plain(o) == plain(new))?;
    Some(old.first_event(i) + at)
}

/// Position of the same function in `old`.
pub(super) fn function(old: &Ports, interface: &str, new: &Function) -> Option<usize> {
    let plain = |function: &Function| Function { doc: String::new(), ..function.clone() };
    let i = old.required.iter().position(|r| r.name == interface)?;
    let at = old.required[i].functions.iter().position(|o| plain(o) == plain(new))?;
    Some(old.first_function(i) + at)
}

/// Position of the same handler in `old`.
pub(crate) fn handler(old: &Ports, interface: &str, new: &Handler) -> Option<usize> {
    let plain = |handler: &Handler| Handler { doc: String::new(), ..handler.clone() };
    let i = old.required.iter().position(|r| r.name == interface)?;
    let at = old.required[i].handlers.iter().position(|o| plain(o) == plain(new))?;
    Some(old.first_handler(i) + at)
}

/// The interface of that name and coordinate frame in `old`.
fn provided(old: &Ports, interface: &Provided) -> Option<usize> {
    old.provided.iter().position(|p| p.name == interface.name && p.tag == interface.tag)
}
