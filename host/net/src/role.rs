//! The rights that a certificate gives its holder, by a name.

use std::fmt;
use std::str::FromStr;

/// The role of a certificate's holder. What each of them may ask is the business of who is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Looks only.
    Viewer,
    /// Runs what is there.
    Operator,
    /// Changes what is there.
    Administrator,
    /// A process with components.
    Host,
    /// The manager of a system.
    Gcm,
}

impl Role {
    pub const ALL: [Role; 5] = [Role::Viewer, Role::Operator, Role::Administrator, Role::Host, Role::Gcm];

    pub fn name(self) -> &'static str {
        match self {
            Role::Viewer => "viewer",
            Role::Operator => "operator",
            Role::Administrator => "administrator",
            Role::Host => "host",
            Role::Gcm => "gcm",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Role, String> {
        Role::ALL.into_iter().find(|role| role.name() == text).ok_or_else(|| {
            let all: Vec<&str> = Role::ALL.into_iter().map(Role::name).collect();
            format!("there is no role \"{text}\": it is one of {}", all.join(", "))
        })
    }
}
