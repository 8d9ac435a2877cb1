//! Reads names and paths, one parser for each, and refuses what is none.
//!
//! Invariant: a refusal says at which character the first fault is, or which parts are wanted.

use std::str::FromStr;

use super::{ComponentId, MemberId, Name, Pattern, PortId, Target};
use crate::Refusal;

/// Longest name, bytes.
const MAX: usize = 63;

impl Name {
    /// # Errors
    /// [`Refusal::BadPath`] with the position of the first character that is not allowed.
    pub fn parse(text: &str) -> Result<Name, Refusal> {
        match fault(text, 0) {
            None => Ok(Name(text.into())),
            Some(why) => Err(Refusal::BadPath { text: text.to_owned(), why }),
        }
    }
}

impl ComponentId {
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
    pub fn isolated(&self) -> Result<ComponentId, Refusal> {
        let process = Name::parse(&format!("{}.{}", self.process, self.component))?;
        Ok(ComponentId { process, component: self.component.clone() })
    }
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

impl Pattern {
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

macro_rules! from_str {
    ($($ty:ident)*) => {$(
        impl FromStr for $ty {
            type Err = Refusal;
            fn from_str(text: &str) -> Result<$ty, Refusal> {
                $ty::parse(text)
            }
        }
    )*};
}
from_str!(Name ComponentId PortId MemberId Pattern Target);

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
