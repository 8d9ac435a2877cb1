//! Checks whether a class fulfils a contract: lists each difference, with what the class has and what the
//! contract says.
//!
//! Invariant: pure, and total over any manifest that parses.

use super::{Carries, Command, Contract, Event, Flows, Interface, Output, leaves_of, leaves_of_payload};
use crate::manifest::{self, Manifest, NamedType, PortType, Type};
use std::fmt;

/// One thing in which a class differs from a contract.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// `interface/member`, an output's name, or the class's.
    pub at: String,
    /// The difference.
    pub problem: Problem,
}

/// A difference between a class and a contract: `have` is the class's, `want` the contract's, `there` the
/// names that exist.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Problem {
    /// The manifest has no class of this name.
    NoSuchClass {
        /// Names of its classes.
        there: Vec<String>,
    },
    /// The class has another safety.
    Safety {
        /// Its safety.
        have: String,
        /// The contract's.
        want: &'static str,
    },
    /// The class lacks an interface that the contract requires.
    MissingInterface {
        /// Names of its provided interfaces.
        there: Vec<String>,
    },
    /// The interface lacks a command that the contract requires.
    MissingCommand {
        /// Kind of the command.
        kind: &'static str,
        /// Type of its argument; empty = none.
        takes: &'static str,
        /// Type of its result; empty = none.
        gives: &'static str,
    },
    /// The interface lacks an event that the contract requires.
    MissingEvent {
        /// Type of its payload; empty = none.
        payload: &'static str,
    },
    /// The class lacks an output that the contract requires.
    MissingOutput {
        /// Names of its outputs.
        there: Vec<String>,
        /// Descriptions of what the output may be.
        want: Vec<String>,
    },
    /// A command is of another kind.
    Kind {
        /// Its kind.
        have: String,
        /// The contract's.
        want: &'static str,
    },
    /// A command has another overflow policy.
    Overflow {
        /// Its policy.
        have: String,
        /// The contract's.
        want: &'static str,
    },
    /// `what` is "argument", "result", "payload" or "type"; `have` and `want` are the first lines that
    /// differ.
    Type {
        /// The thing whose type differs.
        what: &'static str,
        /// Type of the contract, by name.
        want_type: String,
        /// Line of the class's type.
        have: String,
        /// Line of the contract's type.
        want: String,
    },
    /// A type of the class cannot be followed down to its fields.
    NotUnderstood {
        /// The reason.
        why: String,
    },
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at = &self.at;
        let list = |there: &[String]| if there.is_empty() { "none".to_string() } else { there.join(", ") };
        match &self.problem {
            Problem::NoSuchClass { there } => write!(f, "no class `{at}`; there are {}", list(there)),
            Problem::Safety { have, want } => {
                write!(f, "class `{at}` has safety `{have}`: declare it `{want}`")
            }
            Problem::MissingInterface { there } => {
                write!(f, "provided interface `{at}` is missing; there are {}", list(there))
            }
            Problem::MissingCommand { kind, takes, gives } => {
                write!(f, "command `{at}` is missing: a {kind} command")?;
                if !takes.is_empty() {
                    write!(f, " that takes {takes}")?;
                }
                if gives.is_empty() { Ok(()) } else { write!(f, " that gives {gives}") }
            }
            Problem::MissingEvent { payload } => {
                write!(f, "event `{at}` is missing")?;
                if payload.is_empty() { Ok(()) } else { write!(f, ": it carries {payload}") }
            }
            Problem::MissingOutput { there, want } => {
                write!(f, "output `{at}` is missing: {}; there are {}", want.join(" or "), list(there))
            }
            Problem::Kind { have, want } => write!(f, "command `{at}` is {have}, the contract says {want}"),
            Problem::Overflow { have, want } => {
                write!(f, "command `{at}` has overflow `{have}`, the contract says `{want}`")
            }
            Problem::Type { what, want_type, have, want } => {
                write!(f, "{what} of `{at}` is not {want_type}: it has `{have}`, the contract says `{want}`")
            }
            Problem::NotUnderstood { why } => write!(f, "`{at}` cannot be judged: {why}"),
        }
    }
}

/// Returns everything in which `class` of the manifest differs from the contract; empty when it fulfils it.
/// Members beyond the contract do not count.
pub fn check(manifest: &Manifest, class: &str, contract: &Contract) -> Vec<Violation> {
    check_as(manifest, class, contract, "")
}

/// Checks as [`check`] does, where the contract's required interface is called `interface` in the class
/// ("arm_left"), as in a class with several devices. Empty: as the contract calls it.
pub fn check_as(manifest: &Manifest, class: &str, contract: &Contract, interface: &str) -> Vec<Violation> {
    match manifest.classes.iter().find(|c| c.name == class) {
        Some(class) => check_class(&manifest.types, class, contract, interface),
        None => {
            let there = manifest.classes.iter().map(|c| c.name.clone()).collect();
            vec![Violation { at: class.to_string(), problem: Problem::NoSuchClass { there } }]
        }
    }
}

/// Checks as [`check_as`] does a class whose description is at hand, with the types it names.
pub fn check_class(
    types: &[NamedType],
    class: &manifest::Class,
    contract: &Contract,
    interface: &str,
) -> Vec<Violation> {
    let mut found = Found { types, called: interface, violations: Vec::new() };
    found.class(class, contract);
    found.violations
}

struct Found<'a> {
    types: &'a [NamedType],
    /// Name of the required interface in the class; empty = as in the contract.
    called: &'a str,
    violations: Vec<Violation>,
}

impl Found<'_> {
    fn add(&mut self, at: &str, problem: Problem) {
        self.violations.push(Violation { at: at.to_string(), problem });
    }

    fn class(&mut self, class: &manifest::Class, contract: &Contract) {
        if class.safety != contract.safety {
            self.add(&class.name, Problem::Safety { have: class.safety.clone(), want: contract.safety });
        }
        for interface in contract.interfaces {
            let renamed = interface.required && !self.called.is_empty();
            let name = if renamed { self.called } else { interface.name };
            match class.provided.iter().find(|p| p.name == name) {
                Some(have) => self.interface(have, interface),
                None if interface.required => {
                    let there = class.provided.iter().map(|p| p.name.clone()).collect();
                    self.add(name, Problem::MissingInterface { there });
                }
                None => {}
            }
        }
        for output in contract.outputs {
            match class.outputs.iter().find(|o| o.name == output.name) {
                Some(have) => self.output(have, output),
                None if output.required => {
                    let there = class.outputs.iter().map(|o| o.name.clone()).collect();
                    let want = output.one_of.iter().map(Flows::text).collect();
                    self.add(output.name, Problem::MissingOutput { there, want });
                }
                None => {}
            }
        }
    }

    fn interface(&mut self, have: &manifest::Provided, want: &Interface) {
        for command in want.commands {
            let at = format!("{}/{}", have.name, command.name);
            match have.commands.iter().find(|c| c.name == command.name) {
                Some(have) => self.command(&at, have, command),
                None if command.required => {
                    let (kind, takes, gives) = (command.kind, command.arg.ty, command.ret.ty);
                    self.add(&at, Problem::MissingCommand { kind, takes, gives });
                }
                None => {}
            }
        }
        for event in want.events {
            let at = format!("{}/{}", have.name, event.name);
            match have.events.iter().find(|e| e.name == event.name) {
                Some(have) => self.event(&at, have, event),
                None if event.required => {
                    self.add(&at, Problem::MissingEvent { payload: event.payload.ty });
                }
                None => {}
            }
        }
    }

    fn command(&mut self, at: &str, have: &manifest::Command, want: &Command) {
        if have.kind != want.kind {
            return self.add(at, Problem::Kind { have: have.kind.clone(), want: want.kind });
        }
        if !want.overflow.is_empty() && have.overflow != want.overflow {
            self.add(at, Problem::Overflow { have: have.overflow.clone(), want: want.overflow });
        }
        let arg = have.arg.as_ref().map(|a| (&a.ty, a.unit.as_str()));
        self.carries(at, "argument", arg, want.arg);
        self.carries(at, "result", have.ret.as_ref().map(|t| (t, have.ret_unit.as_str())), want.ret);
    }

    fn event(&mut self, at: &str, have: &manifest::Event, want: &Event) {
        self.carries(at, "payload", have.payload.as_ref().map(|t| (t, have.unit.as_str())), want.payload);
    }

    fn output(&mut self, have: &manifest::Output, want: &Output) {
        let at = want.name;
        let differences: Vec<Problem> = want.one_of.iter().filter_map(|w| self.flow(&have.ty, w)).collect();
        // Only the last difference is told: alternatives differ first in their kind, and one of them is
        // enough.
        if differences.len() == want.one_of.len()
            && let Some(problem) = differences.into_iter().next_back()
        {
            self.add(at, problem);
        }
    }

    /// Returns the difference between a port's type and what should flow.
    fn flow(&self, have: &PortType, want: &Flows) -> Option<Problem> {
        let differs = |have: String| {
            Some(Problem::Type { what: "type", want_type: want.text(), have, want: want.text() })
        };
        match (have, want) {
            (PortType::Plain { plain }, Flows::Samples(payload)) => {
                self.difference("type", Some((plain, "")), Carries::of(payload))
            }
            (PortType::Frame { frame, format, .. }, Flows::Frames { header, format: want })
                if format == want =>
            {
                self.difference("header", Some((frame, "")), Carries::of(header))
            }
            (PortType::Frame { format, .. }, _) => differs(format!("frames of format `{format}`")),
            (PortType::Plain { .. }, _) => differs("plain samples".to_string()),
            (PortType::Any(_), _) => differs("any type".to_string()),
        }
    }

    fn carries(&mut self, at: &str, what: &'static str, have: Option<(&Type, &str)>, want: Carries) {
        if let Some(problem) = self.difference(what, have, want) {
            self.add(at, problem);
        }
    }

    fn difference(&self, what: &'static str, have: Option<(&Type, &str)>, want: Carries) -> Option<Problem> {
        let wanted = if want.ty.is_empty() { Vec::new() } else { leaves_of_payload(want.ty, want.unit) };
        let had = match have.map(|(ty, unit)| leaves_of(self.types, ty, unit)) {
            None => Vec::new(),
            Some(Ok(leaves)) => leaves,
            Some(Err(why)) => return Some(Problem::NotUnderstood { why }),
        };
        if had == wanted {
            return None;
        }
        let line = |lines: &[String], at: usize| {
            lines.get(at).map_or("nothing".to_string(), |line| line.trim_start_matches(": ").to_string())
        };
        let at = had.iter().zip(&wanted).take_while(|(a, b)| a == b).count();
        let want_type = if want.ty.is_empty() { "nothing" } else { want.ty }.to_string();
        Some(Problem::Type { what, want_type, have: line(&had, at), want: line(&wanted, at) })
    }
}

impl Flows {
    /// `samples of Wrench`, `frames with ImageHeader, format "image"`.
    pub fn text(&self) -> String {
        match self {
            Flows::Samples(payload) => format!("samples of {payload}"),
            Flows::Frames { header, format } => format!("frames with {header}, format \"{format}\""),
        }
    }
}
