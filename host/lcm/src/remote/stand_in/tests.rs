#![allow(clippy::unwrap_used)]

use std::sync::{Arc, Weak};

use proptest::prelude::*;
use trocar_model::{PortType, Prim, Type};
use trocar_net::line::{Clock, Outbox};
use trocar_rt::mailbox::{EntryHead, Overflow, Push};
use trocar_rt::segment::{Agreed, CallShape, RemoteCalls, ServedCalls, StreamShape};
use trocar_rt::stream::{Payload, Queue, RemoteViews};
use trocar_rt::wake::Waker;

use super::super::super::boundary::Lane;
use super::super::super::gate::Presence;
use super::client::AbsentClient;
use super::codec::put;
use super::server::AbsentServer;
use super::writer::{AbsentWriter, carries};
use super::*;

const AGREED: Agreed = Agreed { hash: 7, epoch: 9 };
const LINK: Link = Link { connection: 1, epoch: 9 };
const DEPTH: usize = 4;

fn shape() -> CallShape {
    CallShape {
        depth: DEPTH,
        commands: 1,
        arg_bytes: 8,
        reply_cells: 2,
        ret_bytes: 8,
        text_bytes: 16,
        event_bytes: 8,
        reads: vec![8],
        own_reads: 0,
    }
}

fn bell() -> Arc<Waker> {
    Arc::new(Waker::new())
}

/// A server that is there, and whoever stands in for its client.
fn client() -> (ServedCalls, AbsentClient) {
    let calls = ServedCalls::create(&shape(), AGREED).unwrap();
    calls.server.set(Presence::Active as u64);
    let memory = calls.fd().unwrap().try_clone_to_owned().unwrap();
    let lane = Lane { index: 0, ages: false, arg_bytes: 8, ret_bytes: 8, overflow: Overflow::Reject };
    let absent = AbsentClient::open(memory, &shape(), AGREED, (vec![lane], bell()), Weak::new()).unwrap();
    (calls, absent)
}

/// A client that is there, and whoever stands in for its server.
fn server() -> (RemoteCalls, AbsentServer) {
    let (absent, memory) = AbsentServer::create(&shape(), AGREED, bell()).unwrap();
    (RemoteCalls::open(memory, &shape(), AGREED).unwrap(), absent)
}

/// Messages of one stand-in: kind and content, without the link in front.
fn said(by: &dyn StandIn) -> Vec<(Kind, Vec<u8>)> {
    let mut out = Outbox::default();
    by.fill(LINK, &mut out);
    let (mut rest, mut all) = (out.bytes(), Vec::new());
    while let Some((length, behind)) = rest.split_first_chunk() {
        let (message, behind) = behind.split_at(u32::from_le_bytes(*length) as usize);
        all.push((Kind::of(message[0]).unwrap(), message[17..].to_vec()));
        rest = behind;
    }
    all
}

/// Takes what one says to the other.
fn pass(from: &dyn StandIn, to: &dyn StandIn) {
    for (kind, content) in said(from) {
        to.came(kind, Take::new(&content), &Clock::default()).unwrap();
    }
}

fn ready(absent: &dyn StandIn) {
    absent.came(Kind::Ready, Take::new(&[]), &Clock::default()).unwrap();
}

fn send(calls: &RemoteCalls) -> Push {
    calls.commands.push(EntryHead::default(), &[0; 8], Overflow::Reject)
}

fn taken(calls: &ServedCalls) -> usize {
    calls.commands.drain(|_, _| (), |_| ())
}

#[test]
fn no_more_commands_are_on_their_way_than_the_server_has_room_for() {
    let ((here, absent_server), (there, absent_client)) = (server(), client());
    ready(&absent_client);
    for _ in 0..3 {
        // Commands that wait there have room again in the queue here; beyond that it is full.
        (0..DEPTH).for_each(|_| assert_eq!(send(&here), Push::Queued));
        pass(&absent_server, &absent_client);
        (0..DEPTH).for_each(|_| assert_eq!(send(&here), Push::Queued));
        pass(&absent_server, &absent_client);
        assert_eq!(send(&here), Push::Full);
        assert_eq!(taken(&there), DEPTH);
        pass(&absent_client, &absent_server);
        pass(&absent_server, &absent_client);
        assert_eq!(taken(&there), DEPTH);
        pass(&absent_client, &absent_server);
    }
}

#[test]
fn commands_before_the_cut_come_and_later_ones_are_refused() {
    let ((here, absent_server), (there, absent_client)) = (server(), client());
    ready(&absent_client);
    (0..DEPTH).for_each(|_| assert_eq!(send(&here), Push::Queued));
    absent_server.leave();
    assert!(!absent_server.is_over() && !absent_client.is_over());
    pass(&absent_server, &absent_client);
    assert!(absent_server.is_over() && absent_client.is_over());
    assert_eq!((taken(&there), send(&here)), (DEPTH, Push::Closed));
}

#[test]
fn what_waits_in_the_queue_of_the_server_is_lost_at_that_end_alone() {
    let ((here, absent_server), (_there, absent_client)) = (server(), client());
    ready(&absent_client);
    (0..3).for_each(|_| assert_eq!(send(&here), Push::Queued));
    pass(&absent_server, &absent_client);
    assert_eq!(absent_server.lost(), 3, "it is not known yet that they have come");
    pass(&absent_client, &absent_server);
    assert_eq!(absent_server.lost(), 0, "they wait there, and are counted there");
}

#[test]
fn a_command_that_overtakes_the_word_that_its_end_is_ready_is_taken() {
    let ((here, absent_server), (there, absent_client)) = (server(), client());
    assert_eq!(send(&here), Push::Queued);
    pass(&absent_server, &absent_client);
    ready(&absent_client);
    assert_eq!(taken(&there), 1);
}

#[test]
fn a_lost_line_leaves_undone_what_waits_here_and_what_is_not_known_to_have_come() {
    let ((here, absent_server), (there, absent_client)) = (server(), client());
    ready(&absent_client);
    assert_eq!(send(&here), Push::Queued);
    pass(&absent_server, &absent_client);
    assert_eq!(taken(&there), 1);
    pass(&absent_client, &absent_server);
    assert_eq!(absent_server.lost(), 0);
    assert_eq!((send(&here), send(&here)), (Push::Queued, Push::Queued));
    assert_eq!(said(&absent_server).len(), 2);
    assert_eq!(send(&here), Push::Queued);
    assert_eq!(absent_server.lost(), 3);
}

#[test]
fn a_client_that_keeps_to_no_bound_is_listened_to_no_more() {
    let (_there, absent) = client();
    let command = [0; 32];
    let came = || absent.came(Kind::Command, Take::new(&command), &Clock::default());
    (0..2 * DEPTH).for_each(|_| came().unwrap());
    assert!(came().unwrap_err().contains("room"));
}

fn frames(max_bytes: usize) -> PortType {
    PortType::Frame { header: Type::Prim(Prim::F64), format: "any".into(), max_bytes }
}

fn frame(header: usize, bytes: usize) -> Vec<u8> {
    let mut content = Vec::new();
    put(&mut content, [1, 2, 3]);
    content.extend_from_slice(&(header as u32).to_le_bytes());
    content.resize(content.len() + header + bytes, 0);
    content
}

fn writer(max_bytes: usize) -> AbsentWriter {
    let ty = frames(max_bytes);
    let shape = StreamShape { payload: Payload::Frame, queue: Queue::Latest };
    AbsentWriter::create(&ty, (shape, 1), AGREED, RemoteViews::new(8)).unwrap().0
}

#[test]
fn frames_that_grow_have_room_and_those_that_cannot_be_are_refused() {
    let came = |absent: &AbsentWriter, header, bytes| {
        absent.came(Kind::Frame, Take::new(&frame(header, bytes)), &Clock::default())
    };
    let growing = writer(0);
    for bytes in (1..100).map(|n| n * 50_000) {
        came(&growing, 8, bytes).unwrap();
    }
    let mut detail = LinkDetail::default();
    growing.correct(&mut detail);
    assert_eq!((detail.dropped, detail.came), (0, 99), "few pools are enough");
    let known = writer(1000);
    came(&known, 8, 1000).unwrap();
    assert!(came(&known, 8, 1001).unwrap_err().contains("1001"));
    assert!(came(&known, 16, 10).unwrap_err().contains("16 + 10"));
    assert!(carries(&frames(1 << 20)).is_ok() && carries(&frames(1 << 30)).unwrap_err().contains("longer"));
}

proptest! {
    /// Whatever a peer says is taken in or refused, and harms nothing.
    #[test]
    fn any_message_is_taken_in_or_refused(kind in 0_u8..14, content in prop::collection::vec(any::<u8>(), 0..80)) {
        let Some(kind) = Kind::of(kind) else { return Ok(()) };
        let ((_there, absent_client), (_here, absent_server)) = (client(), server());
        ready(&absent_client);
        let all: [&dyn StandIn; 3] = [&absent_client, &absent_server, &writer(64)];
        for absent in all {
            let _ = absent.came(kind, Take::new(&content), &Clock::default());
            said(absent);
        }
    }
}
