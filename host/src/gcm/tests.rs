//! What a GCM promises, against an LCM that does as it is told.
#![allow(clippy::unwrap_used)]
