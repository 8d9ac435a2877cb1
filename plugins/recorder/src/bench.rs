//! Throughput of the way from a step to a file, beside the crate `mcap` alone; for `examples/throughput.rs`.
//!
//! Invariant: both sides write the same messages to the same directory, and what is timed ends when the file
//! is closed.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::BufWriter;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use mcap::WriteOptions;
use mcap::records::MessageHeader;

use crate::block::Kind;
use crate::orders::{Channel, Codec, Opening, Order};
use crate::way::way;
use crate::writer::Writer;

/// Messages that are pushed in what stands for a step.
const A_STEP: u64 = 64;
/// Bytes that may be on their way.
const LIMIT: u64 = 64 << 20;

fn file(path: &Path) -> std::io::Result<File> {
    OpenOptions::new().read(true).write(true).create_new(true).open(path)
}

/// Writes `n` messages of `len` bytes as a recorder does: how long it takes, s.
///
/// # Errors
/// The sentence of the file system.
pub fn ours(path: &Path, n: u64, len: usize) -> std::io::Result<f64> {
    let (mut way, orders, returns) = way(LIMIT);
    let (tell, _news) = std::sync::mpsc::channel();
    let writer = Writer::new(returns, tell, (0, 0));
    let message = vec![7u8; len];
    let file = file(path)?;
    let begun = Instant::now();
    let thread = std::thread::spawn(move || writer.run(&orders, || {}));
    way.order(Order::Channel(Box::new(Channel {
        topic: "/a".into(),
        schema: "a".into(),
        schema_encoding: "jsonschema",
        schema_data: b"{}".to_vec(),
        encoding: "json",
        metadata: BTreeMap::new(),
    })));
    let opening =
        Opening { file, path: path.to_owned(), codec: Codec::Raw, since_ns: 0, written: Arc::default() };
    way.order(Order::Open(Box::new(opening)));
    for seq in 0..n {
        // A recorder would count these as lost; here the time of all of them is wanted.
        while !way.has_room(len + 128) {
            way.send();
            std::thread::yield_now();
        }
        way.block().push((0, seq, seq, seq), Kind::Ready, |to| to.extend_from_slice(&message));
        if seq % A_STEP == A_STEP - 1 {
            way.send();
        }
    }
    way.order(Order::Close("enough".into()));
    drop(way);
    thread.join().map_err(|_| std::io::Error::other("the writer panicked"))?;
    Ok(begun.elapsed().as_secs_f64())
}

/// The same by the crate alone, with its chunks of 64 KiB.
///
/// # Errors
/// The sentence of the file system.
pub fn bare(path: &Path, n: u64, len: usize) -> std::io::Result<f64> {
    let message = vec![7u8; len];
    let file = file(path)?;
    let begun = Instant::now();
    let options = WriteOptions::new().compression(None).chunk_size(Some(64 << 10));
    let mut writer = options.create(BufWriter::new(file)).map_err(std::io::Error::other)?;
    let schema = writer.add_schema("a", "jsonschema", b"{}").map_err(std::io::Error::other)?;
    let channel_id =
        writer.add_channel(schema, "/a", "json", &BTreeMap::new()).map_err(std::io::Error::other)?;
    for seq in 0..n {
        let header = MessageHeader { channel_id, sequence: seq as u32, log_time: seq, publish_time: seq };
        writer.write_to_known_channel(&header, &message).map_err(std::io::Error::other)?;
    }
    writer.finish().map_err(std::io::Error::other)?;
    drop(writer);
    Ok(begun.elapsed().as_secs_f64())
}
