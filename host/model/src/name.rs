//! Names and paths: `process/component/port/member`, one spelling and one parser each.
//!
//! Invariant: what `Display` prints, `parse` reads back; nothing outside this file splits a path.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use crate::Refusal;

/// Longest name, bytes.
const MAX: usize = 63;

/// One segment of a path: `[A-Za-z_][A-Za-z0-9_.-]{0,62}`.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Name(Arc<str>);

impl Name {
    /// # Errors
    /// [`Refusal::BadPath`] with the position of the first character that is not allowed.
    pub fn parse(text: &str) -> Result<Name, Refusal> {
        match fault(text, 0) {
            None => Ok(Name(text.into())),
            Some(why) => Err(Refusal::BadPath { text: text.to_owned(), why }),
        }
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// Tells what is wrong with `segment`, which begins at character `at` (0-based) of a path.
fn fault(segment: &str, at: usize) -> Option<String> {
    if segment.is_empty() {
        return Some(format!("a name is missing at character {}", at + 1));
    }
    for (i, c) in segment.chars().enumerate() {
        let letter = c.is_ascii_alphabetic() || c == '_';
        let other = c.is_ascii_digit() || c == '.' || c == '-';
        let fits = letter || (other && i > 0);
        if !fits {
            let rule = if c == '*' {
                "a * stands for several, and one name is meant here"
            } else if i == 0 {
                "a name begins with a letter or _"
            } else {
                "a name holds letters, digits, _ . -"
            };
            return Some(format!("character {} is {c:?}; {rule}", at + i + 1));
        }
    }
    // Every character is ASCII here, so bytes are characters.
    (segment.len() > MAX).then(|| {
        format!(
            "the name at character {} has {} characters; at most {MAX} are allowed",
            at + 1,
            segment.len()
        )
    })
}

/// Splits `text` into exactly `shape.len()` names; `shape` is for the message.
fn parts<const N: usize>(text: &str, shape: [&str; N]) -> Result<[Name; N], Refusal> {
    let bad = |why: String| Refusal::BadPath { text: text.to_owned(), why };
    let wanted = shape.join("/");
    if text.is_empty() {
        return Err(bad(format!("it is empty; wanted {wanted}")));
    }
    if text.starts_with('/') {
        return Err(bad(format!("it begins with a slash; wanted {wanted}")));
    }
    let found: Vec<&str> = text.split('/').collect();
    let mut at = 0;
    for segment in &found {
        if let Some(why) = fault(segment, at) {
            return Err(bad(why));
        }
        at += segment.chars().count() + 1;
    }
    let count = found.len();
    let names: Vec<Name> = found.into_iter().map(|s| Name(s.into())).collect();
    names.try_into().map_err(|_| {
        let much = if count < N { "few" } else { "many" };
        bad(format!("it has too {much} parts ({count}, not {N}); wanted {wanted}"))
    })
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

    /// # Errors
    /// [`Refusal::BadPath`].
    pub fn parse(text: &str) -> Result<ComponentId, Refusal> {
        let [process, component] = parts(text, ["process", "component"])?;
        Ok(ComponentId { process, component })
    }

    /// Returns its id in a process of its own: `host/robot` is then `host.robot/robot`.
    ///
    /// # Errors
    /// [`Refusal::BadPath`]: that process would have too long a name.
    pub fn apart(&self) -> Result<ComponentId, Refusal> {
        let process = Name::parse(&format!("{}.{}", self.process, self.component))?;
        Ok(ComponentId { process, component: self.component.clone() })
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
    /// # Errors
    /// [`Refusal::BadPath`].
    pub fn parse(text: &str) -> Result<PortId, Refusal> {
        let [process, component, port] =
            parts(text, ["process", "component", "port"]).map_err(|refusal| match ComponentId::parse(text) {
                Ok(id) => {
                    let why = format!(
                        "it names a component, not one of its ports: `trocar describe {id}` shows them; wanted \
                         process/component/port"
                    );
                    Refusal::BadPath { text: text.to_owned(), why }
                }
                Err(_) => refusal,
            })?;
        Ok(PortId { component: ComponentId { process, component }, port })
    }

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

impl MemberId {
    /// # Errors
    /// [`Refusal::BadPath`].
    pub fn parse(text: &str) -> Result<MemberId, Refusal> {
        let [process, component, port, member] =
            parts(text, ["process", "component", "interface", "member"])?;
        Ok(MemberId { port: PortId { component: ComponentId { process, component }, port }, member })
    }
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

    /// # Errors
    /// [`Refusal::BadPath`].
    pub fn parse(text: &str) -> Result<Pattern, Refusal> {
        if text == "**" {
            return Ok(Pattern::all());
        }
        // Each * stands for at least one character of a name, so a letter in its place checks the rest of the
        // grammar.
        let plain = text.replace('*', "x");
        match ComponentId::parse(&plain) {
            Ok(_) => {}
            Err(Refusal::BadPath { why, .. }) => {
                let why = format!("{why} (a pattern is **, process/** or process/component with * in them)");
                return Err(Refusal::BadPath { text: text.to_owned(), why });
            }
            Err(other) => return Err(other),
        }
        let (process, component) = text.split_once('/').unwrap_or((text, "*"));
        if process.contains("**") || (component.contains("**") && component != "**") {
            let why = "** stands alone or as the last part, as in ** and host/**".to_owned();
            return Err(Refusal::BadPath { text: text.to_owned(), why });
        }
        Ok(Pattern { process: process.into(), component: component.into() })
    }

    pub fn matches(&self, id: &ComponentId) -> bool {
        glob(self.process.as_bytes(), id.process.as_str().as_bytes())
            && glob(self.component.as_bytes(), id.component.as_str().as_bytes())
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
    /// # Errors
    /// [`Refusal::BadPath`].
    pub fn parse(text: &str) -> Result<Target, Refusal> {
        if text.contains('*') {
            Pattern::parse(text).map(Target::Glob)
        } else {
            ComponentId::parse(text).map(Target::One)
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
macro_rules! path_traits {
    ($($ty:ident)*) => {$(
        impl fmt::Debug for $ty {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(self, f)
            }
        }
        path_traits!(@parse $ty);
    )*};
    (@parse $ty:ident) => {
        impl FromStr for $ty {
            type Err = Refusal;
            fn from_str(text: &str) -> Result<$ty, Refusal> {
                $ty::parse(text)
            }
        }
    };
}
path_traits!(Name ComponentId PortId MemberId Pattern);
path_traits!(@parse Target);

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
