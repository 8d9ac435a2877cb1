//! Libraries whose manifest says `unload` leave the process when nothing of them is left.
//!
//! Invariant: a library is closed only when no code can reach it or is inside of it: no listed file offers
//! it, this is the last handle, and no thread runs that the host did not start and that came since it was
//! loaded.

use std::sync::Arc;

use super::load::LoadedPlugin;

/// Returns the plugin, when it was the last handle and may go; otherwise the handle again.
pub(super) fn last(plugin: Arc<LoadedPlugin>) -> Result<LoadedPlugin, Arc<LoadedPlugin>> {
    // Threads are looked for once no other handle can start one.
    let plugin = Arc::try_unwrap(plugin)?;
    match &plugin.others {
        Some(before) if !before.are_more() => Ok(plugin),
        _ => Err(Arc::new(plugin)),
    }
}
