//! Members of a class, by name: from its description in the program, or from what `describe` wrote last.
//!
//! Invariant: a wrong name or type fails the test with the names that exist, never with garbage bytes.

use std::sync::{Mutex, OnceLock, PoisonError};

use super::manifest;
use crate::class::Class;
use trocar_plugin_api::contracts::{leaves_of, size_of_type};
use trocar_plugin_api::desc::TypeDesc;
use trocar_plugin_api::manifest::{self as m, Description, PortType, Type};

pub(crate) struct Shape {
    description: Description,
    /// Members of each kind, as `Of` numbers them: made once, since a test asks for them at every call.
    members: [OnceLock<Vec<Member>>; 4],
    /// Types that were compared and found to be the same.
    same: Mutex<Vec<Compared>>,
}

/// A comparison that was made: the port's kind and name, and the test's type, by its address.
struct Compared {
    what: String,
    name: String,
    asked: usize,
}

/// A member of an interface: its position over all interfaces, and its types.
#[derive(Clone)]
pub(crate) struct Member {
    pub(crate) id: usize,
    /// `interface/member`.
    pub(crate) path: String,
    /// Position of the member's own name in the path.
    short_at: usize,
    pub(crate) arg: Option<Type>,
    pub(crate) ret: Option<Type>,
    pub(crate) is_read: bool,
    /// Takes the type of what it is connected to.
    pub(crate) any: bool,
    /// With its limits, of a command.
    pub(crate) limited: Option<m::Arg>,
}

#[derive(Clone, Copy)]
pub(crate) enum Of {
    Commands,
    Events,
    Functions,
    Handlers,
}

impl Of {
    fn word(self) -> &'static str {
        match self {
            Of::Commands => "command",
            Of::Events => "event",
            Of::Functions => "function",
            Of::Handlers => "handler",
        }
    }
}

impl Shape {
    pub(crate) fn of<C: Class>() -> Shape {
        Shape::new(manifest::description(C::DESC))
    }

    fn new(description: Description) -> Shape {
        Shape { description, members: Default::default(), same: Mutex::default() }
    }

    /// Reads the JSON that `describe` wrote.
    ///
    /// # Errors
    /// The JSON is no description.
    pub(crate) fn read(json: &[u8]) -> Result<Shape, String> {
        let read = serde_json::from_slice(json).map(Shape::new);
        read.map_err(|e| format!("what `describe` wrote is no description: {e}"))
    }

    pub(crate) fn description(&self) -> &Description {
        &self.description
    }

    pub(crate) fn class(&self) -> &m::Class {
        &self.description.class
    }

    pub(crate) fn types(&self) -> &[m::NamedType] {
        &self.description.types
    }

    pub(crate) fn members(&self, of: Of) -> &[Member] {
        self.members[of as usize].get_or_init(|| self.members_of(of))
    }

    fn members_of(&self, of: Of) -> Vec<Member> {
        let mut out = Vec::new();
        let mut add = |interface: &str, name: &str, arg: &Option<Type>, ret: &Option<Type>, is_read| {
            let path = format!("{interface}/{name}");
            let (arg, ret) = (arg.clone(), ret.clone());
            let short_at = interface.len() + 1;
            out.push(Member { id: out.len(), path, short_at, arg, ret, is_read, any: false, limited: None });
        };
        let class = &self.description.class;
        match of {
            Of::Commands => class.provided.iter().for_each(|p| {
                p.commands.iter().for_each(|c| {
                    let arg = c.arg.as_ref().map(|a| a.ty.clone());
                    add(&p.name, &c.name, &arg, &c.ret, c.kind.ends_with("read"));
                })
            }),
            Of::Events => class.provided.iter().for_each(|p| {
                p.events.iter().for_each(|e| add(&p.name, &e.name, &e.payload, &None, false));
            }),
            Of::Functions => class.required.iter().for_each(|r| {
                r.functions.iter().for_each(|f| add(&r.name, &f.name, &f.arg, &f.ret, false));
            }),
            Of::Handlers => class.required.iter().for_each(|r| {
                r.handlers.iter().for_each(|h| add(&r.name, &h.name, &h.payload, &None, false));
            }),
        }
        match of {
            Of::Commands => {
                let commands = class.provided.iter().flat_map(|p| &p.commands);
                out.iter_mut().zip(commands).for_each(|(m, c)| m.limited.clone_from(&c.arg));
            }
            Of::Functions => {
                let functions = class.required.iter().flat_map(|r| &r.functions);
                out.iter_mut().zip(functions).for_each(|(m, f)| m.any = f.any);
            }
            Of::Events | Of::Handlers => {}
        }
        out
    }

    /// `member` or `interface/member`.
    #[track_caller]
    pub(crate) fn member(&self, of: Of, name: &str) -> Member {
        let (what, members) = (of.word(), self.members(of));
        let there = || -> Vec<String> { members.iter().map(|m| m.path.clone()).collect() };
        let mut found = members.iter().filter(|m| m.path == name || m.path[m.short_at..] == *name);
        match (found.next(), found.next()) {
            (Some(member), None) => member.clone(),
            (Some(_), Some(_)) => {
                panic!(
                    "several {what}s are called `{name}`, say interface/name; there are {}",
                    there().join(", ")
                )
            }
            (None, _) => panic!("{}", unknown(what, name, &there())),
        }
    }

    #[track_caller]
    pub(crate) fn input(&self, name: &str) -> usize {
        place("input", name, self.description.class.inputs.iter().map(|i| i.name.as_str()))
    }

    #[track_caller]
    pub(crate) fn output(&self, name: &str) -> usize {
        place("output", name, self.description.class.outputs.iter().map(|o| o.name.as_str()))
    }

    /// Fails the test unless the test's type is the class's.
    #[track_caller]
    pub(crate) fn expect_type(
        &self,
        what: &str,
        name: &str,
        have: Option<&Type>,
        asked: Option<&'static TypeDesc>,
    ) {
        let address = asked.map_or(0, |desc| std::ptr::from_ref(desc).addr());
        let mut same = self.same.lock().unwrap_or_else(PoisonError::into_inner);
        if same.iter().any(|s| s.asked == address && s.name == name && s.what == what) {
            return;
        }
        let had = have.map(|ty| leaves_of(self.types(), ty, "").unwrap_or_else(|why| vec![why]));
        let used = asked.map(manifest::leaves);
        if had == used {
            same.push(Compared { what: what.to_owned(), name: name.to_owned(), asked: address });
            return;
        }
        let text = |ty: Option<&Type>| ty.map_or("()".to_string(), type_text);
        let asked = asked.map(manifest::type_of);
        let (mut told, asked) = (text(have), text(asked.as_ref()));
        if let (Some(had), Some(used)) = (had, used)
            && told == asked
            && let Some((had, used)) = had.iter().zip(&used).find(|(a, b)| a != b)
        {
            told = format!("{told} with `{had}` instead of `{used}`");
        }
        panic!("{what} `{name}` has type {told}, the test uses {asked}");
    }

    pub(crate) fn size(&self, ty: Option<&Type>) -> usize {
        ty.map_or(0, |ty| size_of_type(self.types(), ty).unwrap_or_else(|why| panic!("{why}")))
    }
}

/// The type of a plain sample or a frame's header; none for an untyped port.
pub(crate) fn header(ty: &PortType) -> Option<&Type> {
    match ty {
        PortType::Plain { plain: ty } | PortType::Frame { frame: ty, .. } => Some(ty),
        PortType::Any(_) => None,
    }
}

#[track_caller]
fn place<'a>(what: &str, name: &str, names: impl Iterator<Item = &'a str> + Clone) -> usize {
    match names.clone().position(|n| n == name) {
        Some(at) => at,
        // Not in a closure, which would be blamed instead of the test.
        None => panic!("{}", unknown(what, name, &names.map(str::to_string).collect::<Vec<_>>())),
    }
}

/// Returns the sentence for an unknown name: what was asked for, what was probably meant, and what there is.
fn unknown(what: &str, name: &str, there: &[String]) -> String {
    let asked = |full: &String| if name.contains('/') { full.clone() } else { last_part(full) };
    let slip = |full: &&String| {
        let (distance, longer) = (distance(name, &asked(full)), name.len().max(asked(full).len()));
        distance <= (longer / 3).max(usize::from(longer > 1))
    };
    let near = there.iter().filter(slip).min_by_key(|full| distance(name, &asked(full)));
    let hint = near.map_or(String::new(), |near| format!(", did you mean `{near}`?"));
    match there {
        [] => format!("no {what} `{name}`; the class has none"),
        [one] => format!("no {what} `{name}`{hint}; there is {one}"),
        several => format!("no {what} `{name}`{hint}; there are {}", several.join(", ")),
    }
}

/// `set_gain` of `control/set_gain`.
fn last_part(full: &str) -> String {
    full.rsplit('/').next().unwrap_or(full).to_string()
}

/// Letters to change, add or leave out between two names.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut left_above = std::mem::replace(&mut row[0], i + 1);
        for (j, y) in b.iter().enumerate() {
            let above = row[j + 1];
            row[j + 1] = (left_above + usize::from(x != *y)).min(above + 1).min(row[j] + 1);
            left_above = above;
        }
    }
    row[b.len()]
}

/// `Force`, `f64`, `[f64; 3]`.
fn type_text(ty: &Type) -> String {
    match ty {
        Type::Prim(name) | Type::Ref { name } => name.clone(),
        Type::Array { item, n } => format!("[{}; {n}]", type_text(item)),
        Type::List { item, n } => format!("List<{}, {n}>", type_text(item)),
        Type::Text { n } => format!("Text<{n}>"),
    }
}
