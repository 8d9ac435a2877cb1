//! The Local Component Manager: the only owner of this process's components.
//!
//! Invariant: it never runs component code on its own threads and shares no lock with one that does.
#![deny(unsafe_code)]

mod books;
#[allow(unsafe_code, reason = "calls into class tables, and the slots that plugins call")]
mod boundary;
mod calling;
mod carriers;
mod classes;
mod concern;
mod connect;
mod context;
mod core;
mod cycle;
mod described;
mod dynamic;
mod ends;
mod executor;
mod gate;
mod goal;
mod hub;
mod inbox;
mod instance;
mod kept;
mod latches;
mod lifecycle;
mod local;
mod logs;
mod loss;
mod order;
mod outside;
mod passage;
mod pending;
mod readers;
mod reading;
mod realtime;
mod remote;
mod request_queue;
mod rows;
mod services;
mod static_classes;
mod store;
mod supervise;
#[cfg(test)]
mod tests;
mod thread;
mod thumbnail;
mod watch;
#[cfg(test)]
#[path = "../../../tests/src/watchdog.rs"]
#[allow(unreachable_pub, reason = "it is public where it lies")]
mod watchdog;

pub use boundary::{LoadedClass, plugin_log};
pub use classes::Classes;
pub use concern::Concern;
pub use local::{LcmConfig, LocalLcm};
pub use remote::Afar;
pub use request_queue::SERVICE_VERBS;
pub use services::{ReplyTo, Services};
pub use static_classes::{LINKED_IN, StaticClasses};
pub use store::{StoreClasses, offered};
pub use supervise::{ends_by, keep_descriptors, let_go_of_descriptors, own_process};
pub use trocar_lcm_api::*;
