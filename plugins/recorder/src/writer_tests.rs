//! Files as a writer leaves them: closed, cut off, on a disk without room.

use std::fs::{File, OpenOptions};

use super::*;
use crate::block::way;

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

/// Runs a writer over orders, and tells what it told.
fn written(hold: (u64, u64), give: impl FnOnce(&mut crate::block::Way)) -> Vec<News> {
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

fn push(way: &mut crate::block::Way, n: u64, len: usize) {
    way.block().push((0, n, n, n), Kind::Ready, |to| to.extend(std::iter::repeat_n(b' ', len)));
    way.send();
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
        way.order(Order::Lost(vec![("/a".into(), 3)]));
        way.order(Order::Close("enough".into()));
    });
    let [News::Ended { why, messages: 500, whole: true, bytes, .. }] = &news[..] else { panic!("{news:?}") };
    assert_eq!(why, "enough");
    assert_eq!(*bytes, path.metadata().expect("the file").len());
    assert_eq!(sequences(&path), (1..=500).collect::<Vec<u32>>());
    let all = std::fs::read(&path).expect("the file");
    let summary = mcap::Summary::read(&all).expect("a summary").expect("there is one");
    assert_eq!(summary.stats.expect("statistics").message_count, 500);
    let end = summary.metadata_indexes.iter().find(|m| m.name == "trocar.end").expect("the end is told");
    let text =
        String::from_utf8_lossy(&all[end.offset as usize..(end.offset + end.length) as usize]).into_owned();
    assert!(text.contains("lost:/a") && text.contains("enough"), "{text}");
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

#[test]
fn a_file_that_can_take_no_more_is_closed_with_its_end() {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("a.mcap");
    // A room that ends at 1 MB stands for a disk: the real one is filled from outside.
    let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path).expect("a new file");
    let opening =
        Opening { file, path: path.clone(), codec: Codec::Raw, since_ns: 0, written: Arc::default() };
    let Order::Channel(only) = channel("/a") else { panic!("a channel") };
    let Ok(mut open) = OpenFile::new(opening, &[*only], &[]) else { panic!("it opens") };
    open.room = Room::ending_at(open.room, 1 << 20);
    let (mut way, received, _) = way(64 << 20);
    (1..=100).for_each(|n| push(&mut way, n, 20_000));
    drop(way);
    let mut taken = 0;
    let full = received.iter().any(|order| {
        let Order::Block(block) = order else { return false };
        block.messages().any(|(head, bytes)| match open.message(head, bytes) {
            Ok(()) => {
                taken += 1;
                false
            }
            Err(Broken::Full) => true,
            Err(Broken::Other(why)) => panic!("{why}"),
        })
    });
    assert!(full && taken > 10, "{taken} messages");
    let (bytes, whole, told) = open.finish(FULL, &[], &[]);
    assert!(whole && told.is_none() && bytes <= 1 << 20, "{bytes} B {told:?}");
    assert_eq!(sequences(&path), (1..=taken).collect::<Vec<u32>>());
    assert_eq!(File::open(&path).expect("the file").metadata().expect("its length").len(), bytes);
}
