//! Files as a writer leaves them: closed, cut off, on a disk without room.

use std::fs::{File, OpenOptions};

use super::*;
use crate::block::{HeldPart, LARGE, Piece};
use crate::orders::OnItsWay;
use crate::way::way;

fn channel(topic: &str) -> Order {
    Order::Channel(Box::new(Channel {
        topic: topic.into(),
        schema: "trocar.json.a".into(),
        schema_encoding: "jsonschema",
        schema_data: b"{}".to_vec(),
        encoding: "json",
        metadata: BTreeMap::new(),
    }))
}

fn opening(path: &std::path::Path, since_ns: u64) -> Order {
    let file = OpenOptions::new().read(true).write(true).create_new(true).open(path).expect("a new file");
    Order::Open(Box::new(Opening {
        file,
        path: path.to_owned(),
        codec: Codec::Raw,
        since_ns,
        written: Arc::default(),
    }))
}

/// Runs a writer over orders, and returns its messages.
fn written(hold: (u64, u64), give: impl FnOnce(&mut crate::way::Way)) -> Vec<Ended> {
    let (mut way, orders, returns) = way(64 << 20);
    let (tell, news) = std::sync::mpsc::channel();
    let writer = Writer::new(returns, tell, hold);
    let thread = std::thread::spawn(move || writer.run(&orders, || {}));
    give(&mut way);
    way.send();
    drop(way);
    thread.join().expect("the writer ends");
    news.try_iter().collect()
}

fn push(way: &mut crate::way::Way, n: u64, len: usize) {
    way.block().push((0, n, n, n), Kind::Ready, |to| to.extend(std::iter::repeat_n(b' ', len)));
    way.send();
}

/// A message whose larger part lies in a frame that is held.
fn push_held(way: &mut crate::way::Way, n: u64, frame: &Arc<HeldPart>) -> Vec<u8> {
    let range = n as usize..frame.bytes().len();
    let piece = Piece::Held(frame.clone(), range.clone());
    way.block().push_with((0, n, n, n), Kind::Ready, |to| to.extend([b'a'; 7]), piece);
    way.send();
    [&[b'a'; 7], &frame.bytes()[range]].concat()
}

fn sequences(path: &std::path::Path) -> Vec<u32> {
    let bytes = std::fs::read(path).expect("the file");
    let messages = mcap::MessageStream::new(&bytes).expect("an MCAP file");
    messages.map(|message| message.expect("a message").sequence).collect()
}

#[test]
fn a_closed_file_holds_everything_and_says_what_was_lost() {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("a.mcap");
    let news = written((0, 0), |way| {
        way.order(channel("/a"));
        push(way, 99, 10); // Before the recording: no part of it.
        way.order(opening(&path, 0));
        (1..=500).for_each(|n| push(way, n, 1000));
        let missing = Missing {
            lost: vec![("/a".into(), 3)],
            interrupted: vec![("/a".into(), 2)],
            silent: vec!["/b".into()],
        };
        way.order(Order::Missing(missing, OnItsWay::default()));
        way.order(Order::Close("enough".into()));
    });
    let [Ended { why, messages: 500, whole: true, bytes, .. }] = &news[..] else { panic!("{news:?}") };
    assert_eq!(why, "enough");
    assert_eq!(*bytes, path.metadata().expect("the file").len());
    assert_eq!(sequences(&path), (1..=500).collect::<Vec<u32>>());
    let all = std::fs::read(&path).expect("the file");
    let summary = mcap::Summary::read(&all).expect("a summary").expect("there is one");
    assert_eq!(summary.stats.expect("statistics").message_count, 500);
    let end = summary.metadata_indexes.iter().find(|m| m.name == "trocar.end").expect("the end is told");
    let text =
        String::from_utf8_lossy(&all[end.offset as usize..(end.offset + end.length) as usize]).into_owned();
    assert!(text.contains("lost:/a") && text.contains("interrupted:/a") && text.contains("enough"), "{text}");
    assert!(text.contains("messages:/b"), "what gave nothing is told: {text}");
}

#[test]
fn what_was_before_a_recording_is_in_it_as_far_as_it_was_held() {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("a.mcap");
    written((50, 1 << 20), |way| {
        way.order(channel("/a"));
        (1..=100).for_each(|n| push(way, n, 10));
        way.order(opening(&path, 70));
        push(way, 101, 10);
    });
    assert_eq!(sequences(&path), (70..=101).collect::<Vec<u32>>());
    let path = dir.path().join("b.mcap");
    written((50, 2000), |way| {
        way.order(channel("/a"));
        (1..=100).for_each(|n| push(way, n, 500));
        way.order(opening(&path, 0));
    });
    let kept = sequences(&path);
    assert!(kept.len() <= 4 && kept.last() == Some(&100), "2000 B hold the newest: {kept:?}");
}

/// Fills a room of so many bytes with what `push` pushes, and reads what is in the file then.
fn filled(room: u64, direct: bool, mut push: impl FnMut(&mut crate::way::Way, u64)) {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("a.mcap");
    // The file stands for a disk: the real one is filled from outside.
    let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path).expect("a new file");
    let opening =
        Opening { file, path: path.clone(), codec: Codec::Raw, since_ns: 0, written: Arc::default() };
    let Order::Channel(only) = channel("/a") else { panic!("a channel") };
    let Ok(mut open) = OpenFile::new(opening, &[*only], &[]) else { panic!("it opens") };
    if direct && !open.mcap.go_direct() {
        eprintln!("skip: the file system of the temporary directory knows the page cache only");
        return;
    }
    open.room = Room::ending_at(open.room, room);
    let (mut way, received, _) = way(64 << 20);
    (1..=100).for_each(|n| push(&mut way, n));
    drop(way);
    let mut taken = 0;
    let full = received.iter().any(|order| {
        let Order::Block(block) = order else { return false };
        block.messages().any(|(head, parts)| match open.message(head, parts) {
            Ok(()) => {
                taken += 1;
                false
            }
            Err(Broken::Full) => true,
            Err(Broken::Other(why)) => panic!("{why}"),
        })
    });
    assert!(full && taken > 10, "{taken} messages");
    let (bytes, whole, told) = open.finish(FULL, &Missing::default(), &[]);
    assert!(whole && told.is_none() && bytes <= room, "{bytes} B {told:?}");
    assert_eq!(sequences(&path), (1..=taken).collect::<Vec<u32>>());
    assert_eq!(File::open(&path).expect("the file").metadata().expect("its length").len(), bytes);
}

#[test]
fn a_file_that_can_take_no_more_is_closed_with_its_end() {
    filled(1 << 20, false, |way, n| push(way, n, 20_000));
}

#[test]
fn a_file_that_can_take_no_more_frames_is_closed_with_its_end() {
    let frame = Arc::new(HeldPart::here(vec![5; 300_000]));
    for (room, direct) in [(8 << 20, false), (8 << 20, true), (8 << 20 | 12_345, true)] {
        filled(room, direct, |way, n| {
            if n.is_multiple_of(2) {
                push_held(way, n, &frame);
            } else {
                push(way, n, 700);
            }
        });
    }
}

#[test]
fn frames_that_are_held_are_in_the_file_in_their_order_and_let_go_of() {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("a.mcap");
    let frame = Arc::new(HeldPart::here(
        (0..300_000u32).map(|n| (n.wrapping_mul(0x9e37_79b9) >> 24) as u8).collect(),
    ));
    let mut wanted = Vec::new();
    written((0, 0), |way| {
        way.order(channel("/a"));
        way.order(opening(&path, 0));
        for n in 1..=100 {
            match n % 4 {
                0 => push(way, n, 1000),
                // Large, and copied on the way.
                1 => push(way, n, LARGE + 1),
                _ => wanted.push((n, push_held(way, n, &frame))),
            }
        }
    });
    assert_eq!(Arc::strong_count(&frame), 1, "it is let go of");
    assert_eq!(sequences(&path), (1..=100).collect::<Vec<u32>>());
    let bytes = std::fs::read(&path).expect("the file");
    let read: BTreeMap<u64, Vec<u8>> = mcap::MessageStream::new(&bytes)
        .expect("an MCAP file")
        .map(|message| message.expect("a message"))
        .map(|message| (u64::from(message.sequence), message.data.into_owned()))
        .collect();
    assert!(wanted.iter().all(|(n, data)| read.get(n) == Some(data)), "other bytes");
    assert_eq!((read[&8].len(), read[&9].len()), (1000, LARGE + 1));
    // By the index alone.
    let summary = mcap::Summary::read(&bytes).expect("a summary").expect("there is one");
    let stats = summary.stats.as_ref().expect("statistics");
    assert_eq!((stats.message_count, stats.message_start_time, stats.message_end_time), (100, 1, 100));
    let indexed = summary.chunk_indexes.iter().flat_map(|index| {
        let entries = summary.read_message_indexes(&bytes, index).expect("its index");
        let entries: Vec<_> = entries.into_values().flatten().collect();
        entries
            .into_iter()
            .map(|entry| summary.seek_message(&bytes, index, &entry).expect("a message").sequence)
            .collect::<Vec<u32>>()
    });
    assert_eq!(indexed.collect::<Vec<u32>>(), (1..=100).collect::<Vec<u32>>());
}

#[test]
fn what_waits_for_a_recording_holds_no_frame() {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("a.mcap");
    let frame = Arc::new(HeldPart::here(vec![3; 200_000]));
    let (mut way, orders, returns) = way(64 << 20);
    let (tell, _news) = std::sync::mpsc::channel();
    let mut writer = Writer::new(returns, tell, (50, 1 << 20));
    way.order(channel("/a"));
    push_held(&mut way, 5, &frame);
    orders.try_iter().for_each(|order| writer.carry_out(order));
    assert_eq!(Arc::strong_count(&frame), 1);
    writer.carry_out(opening(&path, 0));
    writer.close("enough");
    assert_eq!(sequences(&path), [5]);
}
