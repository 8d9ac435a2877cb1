//! `recorder`: all that components send, as MCAP files that explain themselves.
//!
//! Invariant: no recorded component waits for a recorder; a recording counts the samples that it does not
//! hold.
#![forbid(unsafe_code)]

mod asking;
#[doc(hidden)]
pub mod bench;
mod block;
mod compress;
mod encoder;
mod explain;
mod foxglove;
mod mcap_file;
mod orders;
mod place;
mod recorder;
mod room;
mod running;
mod seen;
mod settings;
mod sink;
mod tap;
mod topic;
mod typed;
mod way;
mod wire;
mod words;
mod writer;

pub use recorder::Recorder;
pub use words::{Note, Phase, Progress, RecordAt, StartRequest, Stopped, Thinning, TopicStatus};

trocar_sdk::trocar_plugin!(Recorder);
