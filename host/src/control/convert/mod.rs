//! Wire ↔ model. Malformed names and values are refused here; nobody behind this folder sees a wire type.

mod graph;
mod json;
mod requests;
mod types;

pub(super) use graph::{Figures, component, connection, list, plugin, process, report};
pub(super) use json::{duration_ns, from_value, to_value};
pub(super) use requests::{
    Common, configure, connect, create, disconnect, remove, step, targets,
};
pub(super) use types::{class, ports};
