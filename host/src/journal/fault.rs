//! Why a journal cannot be used, and at which record.
//!
//! Invariant: errors of the disk that may pass are `Now`; whatever is wrong with bytes that were read is
//! `Damaged`, and no error of the database leaves this folder as it is.

use std::io::{self, ErrorKind};
use std::path::Path;

use trocar_model::Refusal;

use super::SCHEMA;
use crate::gcm::{StoreError, Unusable};

/// A journal that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// First record that is bad; `None`: it is not known, or no record is.
    pub record: Option<u64>,
    pub error: StoreError,
}

/// The same before the file is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Bad {
    pub(super) unusable: Unusable,
    pub(super) record: Option<u64>,
    pub(super) why: String,
}

pub(super) type Res<T> = Result<T, Bad>;

impl Bad {
    pub(super) fn new(unusable: Unusable, why: impl Into<String>) -> Bad {
        Bad { unusable, record: None, why: why.into() }
    }

    pub(super) fn damaged(why: impl Into<String>) -> Bad {
        Bad::new(Unusable::Damaged, why)
    }

    pub(super) fn now(why: impl Into<String>) -> Bad {
        Bad::new(Unusable::Now, why)
    }

    /// A part of a message that is missing or of an unknown kind.
    pub(super) fn unreadable(refusal: &Refusal) -> Bad {
        Bad::damaged(match refusal {
            Refusal::ArgumentInvalid { field, .. } => format!("{field} is missing or of an unknown kind"),
            other => other.to_string(),
        })
    }

    pub(super) fn newer(what: &str, schema: u32) -> Bad {
        let why = format!(
            "a later release wrote {what}, by schema {schema}; this one reads up to schema {SCHEMA}: use \
             that release, or name another directory"
        );
        Bad::new(Unusable::Newer, why)
    }

    /// Names the record, in front of the sentence.
    pub(super) fn in_record(self, number: u64) -> Bad {
        let why = match self.unusable {
            Unusable::Newer => self.why,
            _ => format!("record {number}: {}", self.why),
        };
        Bad { record: Some(number), why, ..self }
    }

    pub(super) fn of_disk(error: &io::Error) -> Bad {
        match error.kind() {
            // A file that is shorter than it says, or not of this kind.
            ErrorKind::UnexpectedEof | ErrorKind::InvalidData | ErrorKind::InvalidInput => {
                Bad::damaged(error.to_string())
            }
            ErrorKind::WouldBlock => Bad::in_use(),
            _ => Bad::now(error.to_string()),
        }
    }

    pub(super) fn in_use() -> Bad {
        Bad::new(Unusable::InUse, "another process has it: end that one first, or name another directory")
    }

    pub(super) fn not_synced() -> Bad {
        let why = "the disk did not confirm what was written, so the newest records may be lost: look at the disk \
                   (`dmesg`), and start again";
        Bad::new(Unusable::NotSynced, why)
    }

    pub(super) fn of(self, file: &Path) -> Fault {
        let Bad { unusable, record, why } = self;
        Fault { record, error: StoreError { file: file.to_owned(), unusable, why } }
    }
}

impl From<redb::Error> for Bad {
    fn from(error: redb::Error) -> Bad {
        use redb::Error as E;
        match error {
            E::Io(error) => Bad::of_disk(&error),
            E::DatabaseAlreadyOpen | E::LockProtocolMismatch => Bad::in_use(),
            E::PreviousIo | E::DatabaseClosed => Bad::now("an earlier access of the disk failed"),
            E::Corrupted(why) => Bad::damaged(why),
            other => Bad::damaged(format!("it is not laid out as a journal: {other}")),
        }
    }
}

/// Errors of single verbs of the database become its one error.
macro_rules! by_way_of_the_one_error {
    ($($error:ident)*) => {$(
        impl From<redb::$error> for Bad {
            fn from(error: redb::$error) -> Bad {
                redb::Error::from(error).into()
            }
        }
    )*};
}
by_way_of_the_one_error!(DatabaseError TransactionError TableError StorageError CommitError);
