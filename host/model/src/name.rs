//! Names and paths: `process/component/port/member`, one spelling each.
//!
//! Invariant: what `Display` prints, `parse` reads back; nothing but `name/parse.rs` splits a path.

mod parse;

use std::fmt;
use std::sync::Arc;

/// One segment of a path: `[A-Za-z_][A-Za-z0-9_.-]{0,62}`.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Name(Arc<str>);

impl Name {
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// `process/component`.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ComponentId {
    pub process: Name,
    pub component: Name,
}

impl ComponentId {
    pub fn new(process: Name, component: Name) -> ComponentId {
        ComponentId { process, component }
    }

    pub fn port(&self, port: Name) -> PortId {
        PortId { component: self.clone(), port }
    }
}

/// `process/component/port`: an input, output, required or provided interface.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PortId {
    pub component: ComponentId,
    pub port: Name,
}

impl PortId {
    pub fn member(&self, member: Name) -> MemberId {
        MemberId { port: self.clone(), member }
    }
}

/// `process/component/port/member`: a command, function, event or handler.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MemberId {
    pub port: PortId,
    pub member: Name,
}

/// A glob over components: `**`, `host/**`, `host/*`, `*/robot`, `host/rob*`. `*` never crosses a slash, `**`
/// does.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Pattern {
    process: Arc<str>,
    component: Arc<str>,
}

impl Pattern {
    /// Every component of every process.
    pub fn all() -> Pattern {
        Pattern { process: "**".into(), component: "**".into() }
    }

    pub fn matches(&self, id: &ComponentId) -> bool {
        glob(self.process.as_bytes(), id.process.as_str().as_bytes())
            && glob(self.component.as_bytes(), id.component.as_str().as_bytes())
    }

    /// Returns the pattern for the components of one process alone; `None`: it matches none there.
    fn within(&self, process: &Name) -> Option<Pattern> {
        let matches = glob(self.process.as_bytes(), process.as_str().as_bytes());
        matches.then(|| Pattern { process: process.as_str().into(), component: self.component.clone() })
    }
}

/// `*` matches any run of bytes, also an empty one. Linear: it only ever goes back to the last star.
fn glob(pattern: &[u8], text: &[u8]) -> bool {
    let (mut p, mut t) = (0, 0);
    let mut back: Option<(usize, usize)> = None;
    while t < text.len() {
        if p < pattern.len() && pattern[p] == b'*' {
            back = Some((p, t));
            p += 1;
        } else if p < pattern.len() && pattern[p] == text[t] {
            p += 1;
            t += 1;
        } else if let Some((star, from)) = back {
            back = Some((star, from + 1));
            p = star + 1;
            t = from + 1;
        } else {
            return false;
        }
    }
    pattern[p..].iter().all(|&b| b == b'*')
}

/// Target of Start, Stop, Resume and Reset: a path, or a glob when it holds a `*`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Target {
    One(ComponentId),
    Glob(Pattern),
}

impl Target {
    /// Every component of every process.
    pub fn everything() -> Target {
        Target::Glob(Pattern::all())
    }

    /// Tells whether the target names the component.
    pub fn names(&self, id: &ComponentId) -> bool {
        match self {
            Target::One(one) => one == id,
            Target::Glob(pattern) => pattern.matches(id),
        }
    }

    /// Returns the target for the components of one process alone; `None`: it names none there.
    pub fn within(&self, process: &Name) -> Option<Target> {
        match self {
            Target::One(id) => (id.process == *process).then(|| self.clone()),
            Target::Glob(pattern) => pattern.within(process).map(Target::Glob),
        }
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Display for ComponentId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.process, self.component)
    }
}

impl fmt::Display for PortId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.component, self.port)
    }
}

impl fmt::Display for MemberId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.port, self.member)
    }
}

impl fmt::Display for Pattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if *self.process == *"**" {
            f.write_str("**")
        } else {
            write!(f, "{}/{}", self.process, self.component)
        }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Target::One(id) => id.fmt(f),
            Target::Glob(pattern) => pattern.fmt(f),
        }
    }
}

/// `Debug` prints the path itself: a failed assertion then reads like a log line.
macro_rules! debug_as_display {
    ($($ty:ident)*) => {$(
        impl fmt::Debug for $ty {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(self, f)
            }
        }
    )*};
}
debug_as_display!(Name ComponentId PortId MemberId Pattern);

impl AsRef<str> for Name {
    fn as_ref(&self) -> &str {
        self.as_str()
    }
}

impl PartialEq<str> for Name {
    fn eq(&self, other: &str) -> bool {
        self.as_str() == other
    }
}

impl PartialEq<&str> for Name {
    fn eq(&self, other: &&str) -> bool {
        self.as_str() == *other
    }
}
