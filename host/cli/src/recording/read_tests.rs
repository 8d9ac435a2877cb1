//! Whole files, files cut off anywhere, files with any bytes changed: an answer or a refusal, never a panic.

use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::WriteOptions;
use proptest::prelude::*;

use super::*;
use crate::recording::{columns, types};

#[derive(Default)]
struct Counting {
    messages: Vec<u32>,
    values: usize,
    types: types::Types,
}

impl Takes for Counting {
    fn message(&mut self, channel: &Channel, header: &MessageHeader, data: &[u8]) -> Result<(), Failure> {
        self.messages.push(header.sequence);
        let reader = columns::Reader::of(channel, &mut self.types);
        self.values += reader.values(channel, data).map_or(0, |all| all.row.len());
        Ok(())
    }
}

/// Fifty messages in ten chunks, and a metadata record.
fn recording(messages: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let options = WriteOptions::new().compression(None).profile("trocar").chunk_size(None);
    let mut writer = options.create(Cursor::new(&mut bytes)).expect("a writer");
    let schema = writer.add_schema("test.Line", "protobuf", &descriptors()).expect("a schema");
    let channel = writer.add_channel(schema, "/a/b/c", "protobuf", &BTreeMap::new()).expect("a channel");
    let mut end = BTreeMap::new();
    end.insert("lost:/a/b/c".to_owned(), "3".to_owned());
    for n in 1..=messages {
        let header =
            MessageHeader { channel_id: channel, sequence: n, log_time: n.into(), publish_time: n.into() };
        // Field 5, text of two bytes.
        writer.write_to_known_channel(&header, &[0x2a, 2, b'h', b'i']).expect("a message");
        if n % 5 == 0 {
            writer.flush().expect("a chunk");
        }
    }
    writer
        .write_metadata(&mcap::records::Metadata { name: "trocar.end".into(), metadata: end })
        .expect("metadata");
    writer.finish().expect("an end");
    drop(writer);
    bytes
}

/// Describes a message with one field, so that a file is short and each place in it is soon tried.
fn descriptors() -> Vec<u8> {
    use prost_types::field_descriptor_proto::Type;
    use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};
    let text = FieldDescriptorProto {
        name: Some("text".into()),
        number: Some(5),
        r#type: Some(Type::String.into()),
        ..Default::default()
    };
    let line = DescriptorProto { name: Some("Line".into()), field: vec![text], ..Default::default() };
    let file = FileDescriptorProto {
        name: Some("line.proto".into()),
        package: Some("test".into()),
        syntax: Some("proto3".into()),
        message_type: vec![line],
        ..Default::default()
    };
    prost_reflect::prost::Message::encode_to_vec(&FileDescriptorSet { file: vec![file] })
}

fn of(bytes: &[u8]) -> (Result<Whole, Failure>, Counting) {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("a.mcap");
    std::fs::write(&path, bytes).expect("a file");
    let mut counting = Counting::default();
    (read(&path, &mut counting), counting)
}

#[test]
fn a_whole_file_gives_everything_that_is_in_it() {
    let (whole, counting) = of(&recording(50));
    let whole = whole.expect("it is read");
    assert!(whole.closed && whole.wrong.is_empty(), "{}", whole.wrong);
    assert_eq!(counting.messages, (1..=50).collect::<Vec<u32>>());
    assert!(counting.values >= 50, "messages are read by their descriptors");
    assert_eq!(whole.told("trocar.end", "lost:/a/b/c"), Some("3"));
    assert_eq!((whole.profile.as_str(), whole.channels.len()), ("trocar", 1));
}

#[test]
fn a_file_that_was_cut_off_gives_all_whole_chunks_before_that_and_says_so() {
    let all = recording(50);
    let (whole, counting) = of(&all[..all.len() - 40]);
    let whole = whole.expect("it is read");
    assert!(!whole.wrong.is_empty());
    assert_eq!(counting.messages.len(), 50);
    let mut most = 0;
    for cut in (9..all.len()).step_by(7) {
        let (whole, counting) = of(&all[..cut]);
        if let Ok(whole) = whole {
            assert!(!whole.wrong.is_empty(), "{cut}");
        }
        assert!(counting.messages.len() >= most, "a longer file has no fewer messages");
        most = counting.messages.len();
        assert_eq!(counting.messages, (1..=most as u32).collect::<Vec<u32>>());
    }
}

#[test]
fn what_is_no_recording_is_refused() {
    for bytes in [&b""[..], b"hello", &[0; 4096], b"\x89MCAP0\r\n"] {
        let failure = of(bytes).0.expect_err("it is none");
        assert!(failure.message.contains("is no MCAP file"), "{}", failure.message);
    }
}

#[test]
fn a_length_that_is_longer_than_the_file_takes_no_memory() {
    for len in [1u64 << 40, u64::MAX, u64::MAX - 8] {
        for opcode in [1u8, 3, 5, 6, 9, 0x0c, 0x80] {
            let mut bytes = b"\x89MCAP0\r\n".to_vec();
            bytes.push(opcode);
            bytes.extend_from_slice(&len.to_le_bytes());
            bytes.extend_from_slice(&[0; 64]);
            let (whole, counting) = of(&bytes);
            assert!(counting.messages.is_empty());
            if let Ok(whole) = whole {
                assert!(!whole.wrong.is_empty());
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_changed_give_an_answer_or_a_refusal(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..20),
        cut in any::<prop::sample::Index>(),
        whole in any::<bool>(),
    ) {
        let mut bytes = recording(20);
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if !whole {
            bytes.truncate(cut.index(bytes.len()));
        }
        let (_, counting) = of(&bytes);
        prop_assert!(counting.messages.len() <= 1000);
    }
}
