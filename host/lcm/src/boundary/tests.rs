//! The boundary from a plugin's view: outcomes, events, streams, ports that change.

#![allow(clippy::unwrap_used)]

mod commands;
mod dynamic;
mod limits;
mod mistakes;
mod script;
mod sentences;
mod streams;
mod told;
mod world;
