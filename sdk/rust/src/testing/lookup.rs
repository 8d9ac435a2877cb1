//! Names of ports and commands to positions, with types checked against the class description.
//!
//! Invariant: a wrong name or type fails the test with what there is, never with garbage bytes.

use crate::payload::{same, type_name};
use trocar_plugin_api::desc::{ClassDesc, PortType, TypeDesc};

/// A member of an interface: its position over all interfaces, and its types.
pub(crate) struct Member {
    pub(crate) id: usize,
    interface: &'static str,
    name: &'static str,
    pub(crate) arg: Option<&'static TypeDesc>,
    pub(crate) ret: Option<&'static TypeDesc>,
    pub(crate) is_read: bool,
}

/// `member` or `interface/member` among `members`.
#[track_caller]
pub(crate) fn member(what: &str, name: &str, members: Vec<Member>) -> Member {
    let there: Vec<String> = members.iter().map(|m| format!("{}/{}", m.interface, m.name)).collect();
    let (interface, short) = name.split_once('/').map_or((None, name), |(i, m)| (Some(i), m));
    let mut found: Vec<Member> = members
        .into_iter()
        .filter(|m| m.name == short && interface.is_none_or(|i| i == m.interface))
        .collect();
    match found.pop() {
        Some(member) if found.is_empty() => member,
        Some(_) => {
            panic!("several {what}s are called `{name}`, say interface/name; there are {}", there.join(", "))
        }
        None => panic!("no {what} `{name}`; there are {}", there.join(", ")),
    }
}

pub(crate) fn commands(class: &ClassDesc) -> Vec<Member> {
    let all = class.provided.iter().flat_map(|p| p.commands.iter().map(move |c| (p.name, c)));
    all.enumerate()
        .map(|(id, (interface, c))| Member {
            id,
            interface,
            name: c.name,
            arg: c.arg.as_ref().map(|a| a.ty),
            ret: c.ret,
            is_read: c.kind.name().ends_with("read"),
        })
        .collect()
}

pub(crate) fn events(class: &ClassDesc) -> Vec<Member> {
    let all = class.provided.iter().flat_map(|p| p.events.iter().map(move |e| (p.name, e)));
    all.enumerate()
        .map(|(id, (interface, e))| Member {
            id,
            interface,
            name: e.name,
            arg: e.payload,
            ret: None,
            is_read: false,
        })
        .collect()
}

pub(crate) fn functions(class: &ClassDesc) -> Vec<Member> {
    let all = class.required.iter().flat_map(|r| r.functions.iter().map(move |f| (r.name, f)));
    all.enumerate()
        .map(|(id, (interface, f))| Member {
            id,
            interface,
            name: f.name,
            arg: f.arg,
            ret: f.ret,
            is_read: false,
        })
        .collect()
}

pub(crate) fn handlers(class: &ClassDesc) -> Vec<Member> {
    let all = class.required.iter().flat_map(|r| r.handlers.iter().map(move |h| (r.name, h)));
    all.enumerate()
        .map(|(id, (interface, h))| Member {
            id,
            interface,
            name: h.name,
            arg: h.payload,
            ret: None,
            is_read: false,
        })
        .collect()
}

/// Fails the test unless the test's type is the class's.
#[track_caller]
pub(crate) fn expect_type(
    what: &str,
    name: &str,
    have: Option<&'static TypeDesc>,
    asked: Option<&'static TypeDesc>,
) {
    let equal = match (have, asked) {
        (None, None) => true,
        (Some(have), Some(asked)) => same(have, asked),
        _ => false,
    };
    let text = |ty: Option<&TypeDesc>| ty.map_or("()".to_string(), type_name);
    assert!(equal, "{what} `{name}` has type {}, the test uses {}", text(have), text(asked));
}

/// The type of a plain sample or a frame's header; none for an untyped port.
pub(crate) fn header(ty: PortType) -> Option<&'static TypeDesc> {
    match ty {
        PortType::Plain(ty) | PortType::Frame { header: ty, .. } => Some(ty),
        PortType::Any => None,
    }
}

/// Position of a named port.
#[track_caller]
pub(crate) fn port(what: &str, name: &str, names: &[&str]) -> usize {
    let at = names.iter().position(|n| *n == name);
    at.unwrap_or_else(|| panic!("no {what} `{name}`; there are {}", names.join(", ")))
}

pub(crate) fn size(ty: Option<&TypeDesc>) -> usize {
    ty.map_or(0, |t| t.size)
}
