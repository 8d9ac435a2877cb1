//! Both ends of a link in one process, through the file that is handed over.
#![allow(clippy::unwrap_used)]

use std::os::fd::OwnedFd;
use std::sync::Arc;

use trocar_rt::segment::{Agreed, CallShape, RemoteCalls, Rows, ServedCalls, Stream, StreamShape};
use trocar_rt::state::{StateReader, StateWriter};
use trocar_rt::stream::{RemotePools, RemoteViews};
use trocar_rt::{
    DropPolicy, EntryHead, Meta, Overflow, Payload, Push, Pushed, Queue, Reply, StreamReader, StreamWriter,
};

const AGREED: Agreed = Agreed { hash: 7, epoch: 9 };

fn shape() -> CallShape {
    CallShape {
        depth: 4,
        commands: 2,
        arg_bytes: 8,
        reply_cells: 2,
        ret_bytes: 16,
        text_bytes: 64,
        event_bytes: 24,
        reads: vec![0, 8, 300],
        own_reads: 2,
    }
}

fn fd(of: Option<std::os::fd::BorrowedFd<'_>>) -> OwnedFd {
    of.unwrap().try_clone_to_owned().unwrap()
}

#[test]
fn commands_answers_events_and_reads_cross_the_memory() {
    let mut server = ServedCalls::create(&shape(), AGREED).unwrap();
    let client = RemoteCalls::open(fd(server.fd()), &shape(), AGREED).unwrap();
    let ticket = client.replies.acquire().unwrap();
    let head = EntryHead { kind: 0, index: 1, reply: ticket.token(), stamp_ns: 0 };
    assert_eq!(client.commands.push(head, &[5; 8], Overflow::Reject), Push::Queued);
    client.for_server.notify();
    assert!(server.for_server.take());
    let mut asked = Vec::new();
    server.commands.drain(
        |head, arg| {
            asked.push((head.index, arg.to_vec()));
            let running = server.replies.begin(head.reply, -1).unwrap();
            running.finish(3, |ret, text| {
                ret[..2].copy_from_slice(&[1, 2]);
                text[..2].copy_from_slice(b"ok");
                2
            });
        },
        |_| {},
    );
    assert_eq!(asked, [(1, vec![5; 8])]);
    let answered =
        ticket.wait(u64::MAX, |ret, text| assert_eq!((&ret[..2], text), (&[1u8, 2][..], &b"ok"[..])));
    assert_eq!(answered, Reply::Done(3));

    let event = EntryHead { kind: 1, index: 0, reply: 0, stamp_ns: 0 };
    assert_eq!(server.events.push(event, &[6; 24], Overflow::Reject), Push::Queued);
    server.for_client.notify();
    assert!(client.for_client.take());
    let mut heard = Vec::new();
    client.events.drain(|_, payload| heard.extend_from_slice(payload), |_| {});
    assert_eq!(heard, [6; 24]);

    let mut row = [0; 300];
    assert!(client.reads[2].latest(&mut row).is_none(), "nothing was published");
    server.reads[2].publish(77, 1, |row| row.fill(8));
    assert_eq!(client.reads[2].latest(&mut row).unwrap().stamp_ns, 77);
    assert_eq!(row, [8; 300]);
    server.server.set(2);
    assert_eq!(client.server.get(), 2);
    server.whys[1].publish(0, 2, |why| why[..2].copy_from_slice(b"no"));
    let mut why = [0; 64];
    let said = client.whys[1].latest(&mut why).unwrap();
    assert_eq!(&why[..said.tick as usize], b"no");
    server.own_reads[1].set(4);
    assert_eq!((client.own_reads[0].get(), client.own_reads[1].get()), (0, 4));
}

fn rows(bytes: usize) -> (Rows<StateWriter>, OwnedFd) {
    let rows = Rows::create(bytes, AGREED).unwrap();
    let file = fd(rows.region().unwrap().fd());
    (rows, file)
}

#[test]
fn rows_are_seen_by_any_number_of_others_and_written_by_one() {
    let (mut rows, file) = rows(24);
    let readers: Vec<_> =
        (0..3).map(|_| Rows::<StateReader>::open(file.try_clone().unwrap(), 24, AGREED).unwrap()).collect();
    assert!(readers[0].end.latest(&mut [0; 24]).is_none(), "nothing was published");
    for n in 1..=9 {
        rows.end.publish(n, 10 * n, |row| row.fill(n as u8));
    }
    for reader in &readers {
        let mut row = [0; 24];
        let info = reader.end.latest(&mut row).unwrap();
        assert_eq!((info.stamp_ns, info.tick, row), (9, 90, [9; 24]));
    }
    let written = std::fs::File::from(file);
    let refused = std::os::unix::fs::FileExt::write_at(&written, &[1], 0).unwrap_err();
    assert_eq!(refused.kind(), std::io::ErrorKind::PermissionDenied, "others only look at it");
}

#[test]
fn rows_of_another_type_or_size_and_memory_others_may_write_are_refused() {
    let (_rows, file) = rows(24);
    let open = |file: &OwnedFd, bytes, agreed| {
        Rows::<StateReader>::open(file.try_clone().unwrap(), bytes, agreed)
            .map(|_| ())
            .unwrap_err()
            .to_string()
    };
    let why = open(&file, 24, Agreed { hash: 8, ..AGREED });
    assert!(why.contains("hash of its types is 0x7, agreed was 0x8"), "{why}");
    let why = open(&file, 4000, AGREED);
    assert!(why.contains("bytes instead of"), "{why}");
    let link = ServedCalls::create(&shape(), AGREED).unwrap();
    let why = open(&fd(link.fd()), 24, AGREED);
    assert!(why.contains("takes new writers"), "{why}");
}

#[test]
fn samples_cross_the_memory_with_their_gaps() {
    let queue = Queue::Fifo { depth: 2, drop: DropPolicy::DropOldest };
    let shape = StreamShape { payload: Payload::Plain { bytes: 8 }, queue };
    let out = Stream::<StreamWriter>::create(shape, AGREED, &Arc::new(RemotePools::default())).unwrap();
    let mut into = Stream::<StreamReader>::open(fd(out.fd()), shape, AGREED, &RemoteViews::new(0)).unwrap();
    for seq in 1..=3 {
        let pushed = out.end.push(&[seq as u8; 8], Meta { stamp_ns: seq, came_ns: 0, seq });
        assert_eq!(pushed, if seq == 3 { Pushed::DroppedOldest } else { Pushed::Queued });
        out.newest_ns.set(seq);
        out.for_reader.notify();
    }
    assert!(into.for_reader.take());
    assert_eq!(into.newest_ns.get(), 3);
    let seen: Vec<u64> = std::iter::from_fn(|| into.end.next().map(|s| s.meta.seq)).collect();
    assert_eq!(seen, [2, 3]);
}

#[test]
fn memory_of_another_link_type_or_size_is_refused() {
    let server = ServedCalls::create(&shape(), AGREED).unwrap();
    let open = |shape: &CallShape, agreed| {
        RemoteCalls::open(fd(server.fd()), shape, agreed).map(|_| ()).unwrap_err().to_string()
    };
    let why = open(&shape(), Agreed { hash: 8, ..AGREED });
    assert!(why.contains("hash of its types is 0x7, agreed was 0x8"), "{why}");
    let why = open(&shape(), Agreed { epoch: 8, ..AGREED });
    assert!(why.contains("its epoch is 0x9"), "{why}");
    let mut more = shape();
    more.depth = 400;
    let why = open(&more, AGREED);
    assert!(why.contains("bytes instead of"), "{why}");
    let stream = StreamShape { payload: Payload::Plain { bytes: 8 }, queue: Queue::Latest };
    let other = Stream::<StreamWriter>::create(stream, AGREED, &Arc::new(RemotePools::default())).unwrap();
    assert!(RemoteCalls::open(fd(other.fd()), &shape(), AGREED).is_err());
}

#[test]
fn the_same_sizes_give_the_same_memory_at_both_ends() {
    for (depth, reads) in [(1, vec![]), (64, vec![8; 100]), (1000, vec![65_536])] {
        let shape = CallShape { depth, reads, ..shape() };
        let server = ServedCalls::create(&shape, AGREED).unwrap();
        RemoteCalls::open(fd(server.fd()), &shape, AGREED).unwrap();
    }
}
