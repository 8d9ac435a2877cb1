//! The two components of the classic client/server example: every basic kind of command, and events back.
//!
//! Invariant: interface, command and event names are those of the published example, so its transcripts
//! replay.
#![forbid(unsafe_code)]

mod client;
mod server;

pub use client::Client;
pub use server::Server;

trocar_sdk::trocar_plugin!(Server, Client);
