//! Orders from the step to the writer, and the writer's answers.
//!
//! Invariant: orders and blocks come by one way, so the writer sees them in the order in which they were
//! given.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use crate::block::Block;

/// An order to the writer.
pub(crate) enum Order {
    Channel(Box<Channel>),
    /// The topic of a channel, while no file has it.
    Renamed(usize, String),
    Block(Block),
    Open(Box<Opening>),
    /// A metadata record, in the file that is open and in each that is opened later.
    Metadata(String, BTreeMap<String, String>),
    /// Everything that is missing so far, for the end of the file.
    Missing(Missing, OnItsWay),
    Close(String),
}

/// Counts its holders: as long as there are two, an order is on its way.
#[derive(Clone, Debug, Default)]
pub(crate) struct OnItsWay(Arc<()>);

impl OnItsWay {
    pub(crate) fn has_arrived(&self) -> bool {
        Arc::strong_count(&self.0) == 1
    }
}

/// Topics of which something is missing.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Missing {
    /// Number of lost samples by topic.
    pub(crate) lost: Vec<(String, u64)>,
    /// Number of times the sources of a topic went away.
    pub(crate) interrupted: Vec<(String, u64)>,
    /// Connected, and nothing has come of it since the recording began.
    pub(crate) silent: Vec<String>,
}

/// A channel as MCAP has it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Channel {
    pub(crate) topic: String,
    pub(crate) schema: String,
    /// "protobuf" or "jsonschema".
    pub(crate) schema_encoding: &'static str,
    pub(crate) schema_data: Vec<u8>,
    /// "protobuf" or "json".
    pub(crate) encoding: &'static str,
    pub(crate) metadata: BTreeMap<String, String>,
}

/// A file that was made, still empty.
pub(crate) struct Opening {
    pub(crate) file: File,
    pub(crate) path: PathBuf,
    pub(crate) codec: Codec,
    /// Time since which held messages belong to it, ns.
    pub(crate) since_ns: u64,
    pub(crate) written: Arc<Written>,
}

/// Part of a recording that is in its file, as the writer tells it.
#[derive(Default)]
pub(crate) struct Written {
    pub(crate) messages: AtomicU64,
    pub(crate) bytes: AtomicU64,
}

/// Encoding of pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Codec {
    #[default]
    Raw,
    Qoi,
    /// JPEG of this quality, 1 to 100.
    Jpeg(u8),
}

/// A file was closed, as the writer tells it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Ended {
    pub(crate) why: String,
    pub(crate) path: PathBuf,
    pub(crate) messages: u64,
    pub(crate) bytes: u64,
    /// Samples that should be in it and are not, including those that could not be compressed.
    pub(crate) lost: u64,
    /// Number of times recorded sources went away.
    pub(crate) interrupted: u64,
    /// The file has its index and its end.
    pub(crate) whole: bool,
}
