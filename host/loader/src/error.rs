//! Every reason why a plugin file, a class or a plugin store is refused.
//!
//! A fault is one row: its fields, its reason code, and its sentence, which sees the fields by name.
//!
//! ```text
//! /// Sizes in bytes.
//! TooLarge { size: u64, limit: u64 } => (BAD_FILE, format!("has {size} bytes, {limit} at most: strip it")),
//! ```
//!
//! Invariant: variants hold values; the sentence with its remedy is written once, in the row, and fits on one
//! line.

use std::fmt;
use std::path::PathBuf;

macro_rules! errors {
    (
        $(#[$about:meta])*
        pub enum $name:ident;
        $(
            $(#[$doc:meta])*
            $kind:ident $({ $($(#[$field_doc:meta])* $field:ident: $ty:ty),* $(,)? })? => (
                $reason:expr,
                $sentence:expr $(,)?
            ),
        )*
    ) => {
        $(#[$about])*
        #[derive(Clone, Debug, PartialEq)]
        pub enum $name {
            $($(#[$doc])* $kind $({ $($(#[$field_doc])* $field: $ty),* })?,)*
        }

        #[allow(unused_variables, reason = "few reasons need a field")]
        impl $name {
            /// The reason code, for programs.
            pub fn reason(&self) -> &'static str {
                match self { $($name::$kind $({ $($field),* })? => $reason,)* }
            }
        }

        #[allow(unused_variables, reason = "a sentence takes those fields that it needs")]
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self { $($name::$kind $({ $($field),* })? => f.write_str(&$sentence),)* }
            }
        }
    };
}

mod fault;

pub use fault::{Fault, Stage};

/// Why a plugin or a class cannot be used.
#[derive(Clone, Debug, PartialEq)]
pub enum PluginError {
    /// One file is not acceptable.
    Refused { file: PathBuf, fault: Fault },
    /// No listed plugin offers the class; `refused` is a refused file whose name looks like the one asked
    /// for.
    ClassNotFound {
        asked: String,
        nearest: Option<String>,
        available: Vec<String>,
        refused: Option<Box<PluginError>>,
    },
    /// A short class name that several plugins offer.
    ClassAmbiguous { asked: String, offered: Vec<String> },
}

errors! {
    /// Why a store cannot be opened.
    pub enum StoreError;

    DirMissing { dir: PathBuf } => ("PLUGIN_DIR", format!(
        "plugin directory {} does not exist: create it with mkdir -p, or name another",
        dir.display()
    )),
    DirNotADirectory { dir: PathBuf } => ("PLUGIN_DIR", format!(
        "{} is not a directory: name the directory that holds the plugins",
        dir.display()
    )),
    DirUnreadable { dir: PathBuf, because: String } => ("PLUGIN_DIR", format!(
        "plugin directory {} cannot be read ({because}): give this user read and execute permission",
        dir.display()
    )),
    StateUnwritable { dir: PathBuf, because: String } => ("STATE_UNWRITABLE", format!(
        "state directory {} cannot be written ({because}): name a writable one with --state DIR",
        dir.display()
    )),
    StateForeign { dir: PathBuf, owner: u32 } => ("STATE_FOREIGN", format!(
        "{} belongs to user {owner}, who could exchange plugins in it: name an own one with --state DIR",
        dir.display()
    )),
    StateNoExec { dir: PathBuf } => ("STATE_NOEXEC", format!(
        "{} is on a filesystem mounted noexec, plugins cannot be loaded from it: name another with --state \
         DIR",
        dir.display()
    )),
    TrustUnknown { asked: String } => ("TRUST", format!(
        "no trust mode `{asked}`: say dev or allowlist:FILE"
    )),
    TrustSigned => (
        "TRUST",
        "trust mode `signed` is not in this version: say allowlist:FILE to load known files only, or dev",
    ),
    AllowList { file: PathBuf, because: String } => ("TRUST", format!(
        "allow list {} cannot be used: {because}: it is a file of your own with {{\"sha256\":[\"…\"]}}",
        file.display()
    )),
}

impl PluginError {
    /// The reason code of the error table.
    pub fn reason(&self) -> &'static str {
        match self {
            PluginError::ClassNotFound { .. } | PluginError::ClassAmbiguous { .. } => "CLASS_NOT_FOUND",
            PluginError::Refused { fault, .. } => fault.reason(),
        }
    }

    /// The file a refusal is about.
    pub fn file(&self) -> Option<&PathBuf> {
        match self {
            PluginError::Refused { file, .. } => Some(file),
            _ => None,
        }
    }
}

impl std::error::Error for PluginError {}
impl std::error::Error for StoreError {}

impl fmt::Display for PluginError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PluginError::Refused { file, fault } => {
                let name = file.file_name().map_or_else(|| file.to_string_lossy(), |n| n.to_string_lossy());
                write!(f, "{name}: {fault}")
            }
            PluginError::ClassNotFound { asked, nearest, available, refused } => {
                write!(f, "no class `{asked}` in any listed plugin")?;
                if let Some(name) = nearest {
                    write!(f, "; did you mean `{name}`?")?;
                }
                match available.is_empty() {
                    true => write!(f, "; no plugin is listed: put its .so into a plugin directory")?,
                    false => write!(f, "; available: {}", available.join(", "))?,
                }
                if let Some(error) = refused {
                    write!(f, "; a file of that name is refused: {error}")?;
                }
                Ok(())
            }
            PluginError::ClassAmbiguous { asked, offered } => {
                write!(f, "class `{asked}` is offered by several plugins: say {}", offered.join(" or "))
            }
        }
    }
}
