//! Whether a history of requests, answered at the same time to many, is one that a system could have given
//! that does one thing after the other.

mod group;
mod search;

pub(crate) use group::{ALL, CLIENTS, Call, Group, Said, There, What};
pub(crate) use search::{Event, explain};
