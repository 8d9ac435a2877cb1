//! The taps of a component's rows and commands, as its core knows them.
//!
//! Invariant: until a reader is connected for the first time a tap costs one relaxed load.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use trocar_plugin_api::abi::Outcome;

/// Takes the rows of a component for those who look on.
pub(crate) trait TellsRows: Send + Sync {
    /// Tells a row, the `row`th that was published. One thread at a time. Real-time.
    fn tell_row(&self, bytes: &[u8], stamp_ns: u64, row: u64);
}

/// Takes the commands of a component for those who look on.
pub(crate) trait TellsCommands: Send + Sync {
    /// Tells that a command of this ABI id came to `outcome`. `arg` is its argument, lent by its caller.
    /// `later`: this thread ran the command and keeps the component of this tap for its turn. Any thread.
    /// Real-time.
    fn tell(&self, command: u32, arg: *const u8, outcome: Outcome, later: bool);

    /// As `tell`, for an argument that may be of any length: another process put it there.
    fn tell_queued(&self, command: u32, arg: &[u8], outcome: Outcome);
}

/// The tap of the rows.
#[derive(Clone)]
pub(crate) struct RowTap {
    listened: Arc<AtomicBool>,
    pub(super) to: Arc<dyn TellsRows>,
}

/// The tap of the commands.
#[derive(Clone)]
pub(crate) struct CommandTap {
    listened: Arc<AtomicBool>,
    pub(crate) to: Arc<dyn TellsCommands>,
}

impl RowTap {
    /// `listened`: true once a reader was connected; from then on its samples are numbered, so that none goes
    /// missing unnoticed.
    pub(crate) fn new(listened: Arc<AtomicBool>, to: Arc<dyn TellsRows>) -> RowTap {
        RowTap { listened, to }
    }

    #[inline(always)]
    pub(super) fn is_listened(&self) -> bool {
        self.listened.load(Ordering::Relaxed)
    }
}

impl CommandTap {
    /// As of [`RowTap::new`].
    pub(crate) fn new(listened: Arc<AtomicBool>, to: Arc<dyn TellsCommands>) -> CommandTap {
        CommandTap { listened, to }
    }

    #[inline(always)]
    pub(crate) fn is_listened(&self) -> bool {
        self.listened.load(Ordering::Relaxed)
    }
}
