//! Requests to a recorder, and its answers.
//!
//! Invariant: the layouts are part of its interface: fields are appended, never changed.

use trocar_sdk::prelude::*;

named_values! {
    /// State of a recorder.
    pub struct Phase: u32 {
        /// Nothing is recorded.
        IDLE = 0,
        /// A recording begins at a time that was asked for.
        WAITING = 1,
        RECORDING = 2,
        PAUSED = 3,
    }
}

/// Request of `start`.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct StartRequest {
    /// The new file, inside of the recorder's directory; it ends with .mcap.
    pub path: Text<1000>,
    /// From now until it begins.
    #[unit("s")]
    pub delay: f64,
    /// Duration of the recording; 0: until it is stopped.
    #[unit("s")]
    pub duration: f64,
}

/// Request of `record_at`.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct RecordAt {
    /// As in `start`.
    pub path: Text<1000>,
    /// When it begins, on the host's clock.
    pub at: Stamp,
    /// Duration of the recording; 0: until it is stopped.
    #[unit("s")]
    pub duration: f64,
}

/// Words about the graph, a setting, anything: what a recording is to be told.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Note {
    /// Kind of the note; becomes the topic /recorder/note_KIND.
    pub kind: Text<64>,
    /// JSON.
    pub json: Text<16000>,
}

/// Part of a topic's samples that is kept.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Thinning {
    /// The input.
    pub input: Text<64>,
    /// Each so many-th sample; 1: all.
    pub every: u64,
    /// At most so many per second; 0: all.
    #[unit("Hz")]
    pub max_rate: f64,
}

/// A recording in numbers.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Progress {
    pub phase: Phase,
    /// Inputs by which something came.
    pub topics: u32,
    /// In the file.
    pub messages: u64,
    /// Length of the file.
    #[unit("B")]
    pub bytes: u64,
    /// Samples that should be in it and are not.
    pub lost: u64,
    /// Since it began.
    #[unit("s")]
    pub elapsed: f64,
    /// Number of times a connection, or the process of a source, went away while it recorded: samples of that
    /// time are not in it.
    pub interrupted: u64,
}

/// The end of a recording.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Stopped {
    pub path: Text<1000>,
    /// Why.
    pub reason: Text<240>,
    pub messages: u64,
    #[unit("B")]
    pub bytes: u64,
    pub lost: u64,
    /// The file has its index and its end.
    pub whole: Flag,
    pub reserved: [u8; 7],
    /// As in `Progress`.
    pub interrupted: u64,
}

/// One topic in numbers.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct TopicStatus {
    /// As in the file.
    pub topic: Text<240>,
    /// The input.
    pub input: Text<64>,
    pub kept: u64,
    /// Left out because less was asked for.
    pub left_out: u64,
    pub lost: u64,
    #[unit("B")]
    pub bytes: u64,
    /// As in `Progress`, of this one.
    pub interrupted: u64,
}
