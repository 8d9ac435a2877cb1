//! The `trocar.v1` gRPC API: messages, clients and servers generated from `proto/trocar/v1`; the messages of
//! the journal, from `proto/trocar/journal/v1`; and the part of etcd's API that a GCM calls, from
//! `proto/etcdserverpb`.
//!
//! Invariant: nothing here is written by hand but this page; `tests/generated.rs` fails when the committed
//! code and the `.proto` files differ (`TROCAR_BLESS=1 cargo test -p trocar-proto` rewrites it).
#![forbid(unsafe_code)]
#![deny(missing_docs)]

/// Messages, clients and servers of package `trocar.v1`.
#[allow(clippy::all, unreachable_pub, missing_docs, rustdoc::all)]
pub mod v1 {
    include!("gen/trocar.v1.rs");
}

/// Messages of package `trocar.journal.v1`: what lies in the journal of a GCM. No port speaks them.
pub mod journal {
    /// Records, snapshots and their parts.
    #[allow(clippy::all, unreachable_pub, missing_docs, rustdoc::all)]
    pub mod v1 {
        include!("gen/trocar.journal.v1.rs");
    }
}

/// Messages and clients of etcd's API, version 3: what a GCM with its journal there calls.
#[allow(clippy::all, unreachable_pub, missing_docs, rustdoc::all)]
pub mod etcd {
    include!("gen/etcdserverpb.rs");
}

/// Encoded `FileDescriptorSet` of `trocar.v1` and everything it imports, with comments: what reflection
/// answers from.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!("gen/trocar.v1.bin");
