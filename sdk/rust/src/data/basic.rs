//! Payloads without a device: a number with its time, a line for people.
//!
//! Invariant: a number without a unit is a number without a unit: a quantity has a payload of its own.
#![allow(
    missing_docs,
    reason = "the docs of fields go into every manifest: a field has one where name, type and unit do not say it all"
)]

use crate as trocar_sdk;
use trocar_sdk::{Payload, Stamp, Text};

/// One number with its time: the simplest signal.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Scalar {
    pub stamp: Stamp,
    pub value: f64,
}

/// A line for people.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Message {
    pub stamp: Stamp,
    pub text: Text<240>,
}
