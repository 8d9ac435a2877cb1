//! Files of small and large messages, read by the crate: from the begin, and by their indexes.

use std::collections::BTreeSet;
use std::fs::OpenOptions;

use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::*;

type Given = (u16, u32, u64, Vec<u8>);

/// A message of this length from that place of a block, in two parts where it is to lie in a frame.
fn message(block: &[u8], n: u32, len: usize) -> ([&[u8]; 2], Vec<u8>) {
    let at = n as usize * 37 % 5000;
    let bytes = &block[at..at + len];
    // Every second large message lies in a frame, behind some bytes before it.
    let parts = if len >= LARGE && n.is_multiple_of(2) { [&block[..20], bytes] } else { [bytes, &[][..]] };
    (parts, parts.concat())
}

/// Writes so many messages on three channels; returns the file and the messages.
fn written(direct: bool) -> Option<(Vec<u8>, Vec<Given>)> {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("a.mcap");
    let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path).expect("a new file");
    let mut sink = Sink::new(file);
    if direct && !sink.go_direct() {
        eprintln!("skip: the file system of the temporary directory knows the page cache only");
        return None;
    }
    let mut file = McapFile::new(sink, "trocar", "a library").expect("it begins");
    let (none, some) = (BTreeMap::new(), BTreeMap::from([("unit:value".to_owned(), "m".to_owned())]));
    let schema = ("a.A", "protobuf", &b"described"[..]);
    let ids = [("/a", &none), ("/b", &some), ("/c", &none)]
        .map(|(topic, metadata)| file.add(topic, "protobuf", metadata, schema).expect("a channel"));
    let block: Vec<u8> = (0..400_000u32).map(|n| (n.wrapping_mul(0x9e37_79b9) >> 24) as u8).collect();
    let mut given = Vec::new();
    for n in 1..=300 {
        let id = ids[n as usize % 3];
        let len = [40, 0, 2000, LARGE, 17, LARGE + 4567, LARGE - 1][n as usize * 5 % 7];
        let (parts, whole) = message(&block, n, len);
        let log_time = 1000 + u64::from(n * 7 % 100);
        let header = MessageHeader { channel_id: id, sequence: n, log_time, publish_time: u64::from(n) };
        file.message(&header, parts).expect("it is written");
        given.push((id, n, log_time, whole));
        match n % 50 {
            13 => assert!(file.flush(true).expect("it is flushed")),
            20 => {
                let metadata = BTreeMap::from([("n".to_owned(), n.to_string())]);
                file.metadata(&Metadata { name: "a.note".into(), metadata }).expect("a note");
            }
            _ => {}
        }
    }
    let (before, promised) = (file.len(), file.end_len());
    file.finish().expect("it ends");
    let (len, closed) = file.into_sink().close();
    closed.expect("it closes");
    // Statistics, footer, offsets are as long in every file.
    assert!(len <= before + promised + 512, "{len} B, {before} before the end, {promised} promised for it");
    let bytes = std::fs::read(&path).expect("the file");
    Some((bytes[..len as usize].to_vec(), given))
}

/// All messages from the begin; every checksum there is compared.
fn read(bytes: &[u8]) -> Vec<Given> {
    let options = LinearReaderOptions::default()
        .with_validate_chunk_crcs(true)
        .with_validate_summary_section_crc(true)
        .with_emit_chunks(false);
    let mut reader = LinearReader::new_with_options(options);
    let (mut rest, mut found) = (bytes, Vec::new());
    while let Some(event) = reader.next_event() {
        match event.expect("a record") {
            LinearReadEvent::ReadRequest(n) => {
                let n = n.min(rest.len());
                reader.insert(n)[..n].copy_from_slice(&rest[..n]);
                reader.notify_read(n);
                rest = &rest[n..];
            }
            LinearReadEvent::Record { data, opcode: op::MESSAGE } => {
                let mcap::records::Record::Message { header, data } =
                    mcap::parse_record(op::MESSAGE, data).expect("a message")
                else {
                    panic!("no message")
                };
                found.push((header.channel_id, header.sequence, header.log_time, data.into_owned()));
            }
            LinearReadEvent::Record { .. } => {}
        }
    }
    found
}

fn holds(direct: bool) {
    let Some((bytes, given)) = written(direct) else { return };
    assert!(read(&bytes) == given, "other messages from the begin");
    let summary = mcap::Summary::read(&bytes).expect("a summary").expect("there is one");
    let stats = summary.stats.as_ref().expect("statistics");
    assert_eq!(
        (stats.message_count, stats.channel_count, stats.schema_count, stats.metadata_count),
        (300, 3, 1, 6)
    );
    assert_eq!((stats.message_start_time, stats.message_end_time), (1000, 1099));
    assert_eq!(stats.channel_message_counts.values().copied().collect::<Vec<u64>>(), [100, 100, 100]);
    assert_eq!(stats.chunk_count as usize, summary.chunk_indexes.len());
    for index in &summary.metadata_indexes {
        let record = &bytes[index.offset as usize..(index.offset + index.length) as usize];
        assert_eq!((record[0], index.name.as_str()), (op::METADATA, "a.note"));
    }
    let mut found: Vec<Given> = Vec::new();
    for index in &summary.chunk_indexes {
        let entries = summary.read_message_indexes(&bytes, index).expect("its index");
        for (channel, entry) in
            entries.iter().flat_map(|(channel, all)| all.iter().map(move |e| (channel, e)))
        {
            let message = summary.seek_message(&bytes, index, entry).expect("a message");
            assert_eq!((message.channel.id, message.log_time), (channel.id, entry.log_time));
            assert!((index.message_start_time..=index.message_end_time).contains(&entry.log_time));
            found.push((channel.id, message.sequence, message.log_time, message.data.into_owned()));
        }
    }
    found.sort_by_key(|(_, sequence, ..)| *sequence);
    assert!(found == given, "other messages by the indexes");
    let opcodes: BTreeSet<u8> =
        summary.chunk_indexes.iter().map(|index| bytes[index.chunk_start_offset as usize]).collect();
    assert_eq!(opcodes, BTreeSet::from([op::CHUNK]));
}

#[test]
fn through_the_page_cache_a_file_holds_what_it_was_given_and_its_indexes_find_it() {
    holds(false);
}

#[test]
fn past_the_page_cache_a_file_holds_what_it_was_given_and_its_indexes_find_it() {
    holds(true);
}
