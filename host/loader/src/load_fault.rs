//! Faults of loading a plugin: the vetting child reports them, and the host may meet them, too.
//!
//! Invariant: the names of variants and fields are the child's words on the wire; both sides are of one
//! binary.

use serde::{Deserialize, Serialize};

use super::Fault;

/// Fault the child reports and the host may also meet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LoadFault {
    UndefinedSymbol {
        symbol: String,
    },
    MissingLibrary {
        name: String,
    },
    OtherLibrary {
        name: String,
        loaded: String,
    },
    DlOpen {
        because: String,
    },
    NoEntry,
    Layout {
        difference: String,
    },
    EntryDiffers {
        what: String,
    },
    Init {
        status: i32,
        /// Last error it logged; empty when it logged none.
        #[serde(default)]
        said: String,
    },
}

impl From<LoadFault> for Fault {
    fn from(fault: LoadFault) -> Fault {
        match fault {
            LoadFault::UndefinedSymbol { symbol } => Fault::UndefinedSymbol { symbol },
            LoadFault::MissingLibrary { name } => Fault::MissingLibrary { name },
            LoadFault::OtherLibrary { name, loaded } => Fault::OtherLibrary { name, loaded },
            LoadFault::DlOpen { because } => Fault::DlOpen { because },
            LoadFault::NoEntry => Fault::NoEntry,
            LoadFault::Layout { difference } => Fault::Layout { difference },
            LoadFault::EntryDiffers { what } => Fault::EntryDiffers { what },
            LoadFault::Init { status, said } => Fault::Init { status, said },
        }
    }
}
