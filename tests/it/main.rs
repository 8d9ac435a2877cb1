//! The outer tests: one module per promise, each against built binaries, real plugins and real grpcurl.
//!
//! Invariant: run by `./tests/run`, which builds and fetches what they need; without it they fail and say so.
//! Tests of a module `counted` judge what processors were given, by counts beside those of a control run:
//! they have the machine for themselves, one at a time. Tests of a module `timed` judge durations and rates:
//! only `./tests/run --times` runs them. All others own what they touch, claim nothing about time, and run
//! beside each other.
#![allow(clippy::unwrap_used)]

mod adapting;
mod arrows;
mod changing_ports;
mod cli;
#[macro_use]
mod conformance;
mod conformance_cross;
mod conformance_random;
mod control_plane;
mod cpp_plugin;
mod demo;
mod deployment;
mod devices;
mod embedding;
mod embedding_client;
mod etcd;
mod faults;
mod fig4;
mod guests;
mod hostile;
mod links;
mod machines;
mod odd_plugins;
mod places;
mod plugin_guide;
mod plugin_loading;
mod processes;
mod purity;
mod realtime;
mod sdk_devices;
mod sdk_helpers;
mod services;
