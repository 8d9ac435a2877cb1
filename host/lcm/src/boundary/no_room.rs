//! A component whose frames the machine has no memory for.

use std::fmt;

use trocar_model::{ComponentId, Refusal};

/// Outputs without memory for their frames.
#[derive(Clone, Debug)]
pub(crate) struct NoRoom {
    pub(crate) outputs: Vec<String>,
    /// All bytes that were asked for.
    pub(crate) bytes: u64,
    /// Memory that is available.
    pub(crate) why: String,
}

/// Most outputs a sentence names.
const NAMED: usize = 3;

impl fmt::Display for NoRoom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named = self.outputs.iter().take(NAMED).map(String::as_str).collect::<Vec<_>>().join(", ");
        write!(f, "it asks for {} bytes for the frames of {named}", self.bytes)?;
        match self.outputs.len().saturating_sub(NAMED) {
            0 => {}
            more => write!(f, " and {more} more")?,
        }
        write!(f, ": {}", self.why)
    }
}

impl NoRoom {
    pub(crate) fn refusal(self, id: &ComponentId) -> Refusal {
        Refusal::NoMemory { id: id.clone(), outputs: self.outputs, bytes: self.bytes, why: self.why }
    }
}
