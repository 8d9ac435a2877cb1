//! The boundary as a plugin sees it: outcomes, events, streams, ports that change.

#![allow(clippy::unwrap_used)]

mod commands;
mod dynamic;
mod mistakes;
mod puppet;
mod streams;
mod world;
