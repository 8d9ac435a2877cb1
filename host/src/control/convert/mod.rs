//! Wire ↔ model. Malformed names and values are refused here; nobody behind this folder sees a wire type.

mod answers;
mod back;
mod change;
mod graph;
mod json;
mod refusal;
mod requests;
mod stopping;
mod types;

pub(super) use answers::{
    detail_in, details, half, half_in, invoke_out, item, item_in, level, line, line_in, link, link_in,
    payload, plugin, plugin_in, reply, reply_in, row, sample, sample_in, selection, selection_out, when,
};
pub(crate) use back::{class as class_in, unreadable};
pub(super) use change::{
    change_in, change_out, classes_in, inventory_in, inventory_out, phases_in, phases_out, remote_in,
    remote_out, slice_in, slice_out, steps_in, steps_out,
};
pub(crate) use change::{
    change_in_with, change_out_with, connection_in, connection_out, report_in, state_in, state_out,
    unclassed_in, unclassed_out, verb_in, verb_out,
};
pub(crate) use graph::report;
pub(super) use graph::{Figures, component, connection, list, process, supervisor, told, wanted};
pub(super) use json::{duration_ns, from_value};
pub(crate) use refusal::{refusal, refusal_info};
pub(crate) use requests::execution;
pub(super) use requests::{
    Common, ToStop, configure, connect, create, disconnect, forget, remove, steps, targets, to_stop,
};
pub(super) use stopping::{
    decision_in, halted_in, halted_out, stop_in, stop_out, stopped_here_in, stopped_here_out,
};
pub(crate) use types::{class, execution_out};
pub(super) use types::{ports, provided};
