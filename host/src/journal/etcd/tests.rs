//! The journal in a real etcd: leads that are lost, members that are gone, answers that are lost, and what is
//! not a journal.

#![allow(clippy::unwrap_used)]

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use prost::Message;
use tokio::runtime::Runtime;
use trocar_proto::journal::v1 as wire;

use super::campaign::{Campaign, Candidate, Won};
use super::client::{Client, Done, delete, put, read, txn};
use super::keys::{Keys, Span};
use super::server::EtcdCluster;
use super::store::EtcdStore;
use super::tenure::Tenure;
use super::writing::{Operation, WITHIN};
use crate::gcm::{Lead, Loaded, Store, Unusable};
use crate::journal::SCHEMA;
use crate::journal::tests::{fold, kinds, said};

const PREFIX: &str = "lab7";
const TTL: Duration = Duration::from_secs(2);

/// A cluster of a test's own, and the GCM that leads there.
pub(in crate::journal) struct Lab {
    runtime: Runtime,
    leader: Option<Tenure>,
    cluster: EtcdCluster,
}

impl Lab {
    pub(in crate::journal) fn new(members: usize) -> Lab {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        Lab { runtime: runtime.unwrap(), leader: None, cluster: EtcdCluster::start(members) }
    }

    fn place(&self) -> String {
        self.cluster.place(PREFIX)
    }

    fn candidate(&self, place: &str) -> Arc<Candidate> {
        Arc::new(Candidate::new(&place.parse().unwrap(), "127.0.0.1:1".into(), TTL).unwrap())
    }

    /// A lead that somebody has won there, with its store.
    fn wins(&self, place: &str) -> (Won, Tenure, EtcdStore) {
        let candidate = self.candidate(place);
        let won = loop {
            match self.runtime.block_on(candidate.campaign()).unwrap() {
                Campaign::Won(won) => break won,
                // Its lease ends.
                Campaign::Follows { .. } => thread::sleep(Duration::from_millis(50)),
            }
        };
        let tenure = self.runtime.block_on(async { Tenure::begin(&candidate, &won) });
        let store = EtcdStore::new(candidate.place(), &won, &tenure).unwrap();
        (won, tenure, store)
    }

    /// The next GCM leads, after the one before let go.
    pub(in crate::journal) fn leads(&mut self) -> EtcdStore {
        if let Some(before) = self.leader.take() {
            self.runtime.block_on(before.resign());
        }
        let (_, tenure, store) = self.wins(&self.place());
        self.leader = Some(tenure);
        store
    }

    fn does(&self, ops: Vec<Operation>) -> Done {
        let client = Client::new(&self.place().parse().unwrap());
        self.runtime.block_on(client.txn(txn(Vec::new(), ops, Vec::new()), WITHIN)).unwrap()
    }

    /// Everything under the prefix, but the leader's key.
    fn content(&self) -> Vec<(Vec<u8>, Vec<u8>)> {
        let all = Span(format!("{PREFIX}/").into_bytes(), format!("{PREFIX}0").into_bytes());
        let client = Client::new(&self.place().parse().unwrap());
        let (kvs, more) = self.runtime.block_on(client.range(read(all, 0, 0), WITHIN)).unwrap();
        assert!(!more);
        let lasting =
            kvs.into_iter().filter(|kv| !kv.key.ends_with(b"/leader") && !kv.key.ends_with(b"/term"));
        lasting.map(|kv| (kv.key, kv.value)).collect()
    }
}

fn keys() -> Keys {
    Keys::new(PREFIX)
}

fn assert_has(loaded: &Loaded, records: &[crate::gcm::Record]) {
    assert_eq!(said(&loaded.records), said(&records));
}

fn is_lost(lead: &Lead) -> bool {
    lead.holds().is_err()
}

#[test]
#[ignore = "needs etcd: ./tests/run etcd"]
fn a_gcm_that_has_lost_the_lead_writes_nothing() {
    let (lab, records) = (Lab::new(1), kinds::records());
    let (won, first, mut store) = lab.wins(&lab.place());
    store.load().unwrap();
    store.append(&records[..2]).unwrap();
    // As when it stands still for longer than its lease, and believes in it nevertheless.
    lab.runtime.block_on(lab.candidate(&lab.place()).resign(&won)).unwrap();
    let (next_won, next, mut next_store) = lab.wins(&lab.place());
    assert!(next_won.term > won.term);
    assert_has(&next_store.load().unwrap(), &records[..2]);
    for _ in 0..2 {
        let refused = store.append(&records[2..]).unwrap_err();
        assert_eq!(refused.unusable, Unusable::NotLeading, "{refused}");
        let refused = store.keep(&kinds::snapshot(&records)).unwrap_err();
        assert_eq!(refused.unusable, Unusable::NotLeading, "{refused}");
    }
    assert!(is_lost(first.lead()) && !is_lost(next.lead()));
    next_store.append(&records[2..4]).unwrap();
    assert_has(&next_store.load().unwrap(), &records[..4]);
}

#[test]
#[ignore = "needs etcd: ./tests/run etcd"]
fn terms_are_given_once_and_the_others_follow() {
    let lab = Lab::new(1);
    let (won, tenure, _) = lab.wins(&lab.place());
    let other = lab.candidate(&lab.place());
    match lab.runtime.block_on(other.campaign()).unwrap() {
        Campaign::Follows { leader, .. } => {
            assert_eq!((leader.address.as_str(), leader.term), ("127.0.0.1:1", won.term))
        }
        Campaign::Won(won) => panic!("two lead: {won:?}"),
    }
    lab.runtime.block_on(tenure.resign());
    let campaigns: Vec<_> = (0..4)
        .map(|_| {
            let candidate = lab.candidate(&lab.place());
            lab.runtime.spawn(async move { candidate.campaign().await })
        })
        .collect();
    let mut terms = Vec::new();
    for campaign in campaigns {
        if let Campaign::Won(won) = lab.runtime.block_on(campaign).unwrap().unwrap() {
            terms.push(won.term);
        }
    }
    assert_eq!(terms, [won.term + 1], "one of four leads, in the next term");
}

#[test]
#[ignore = "needs etcd: ./tests/run etcd"]
fn a_leader_that_is_not_heard_is_followed_for_its_lease_and_no_longer() {
    let lab = Lab::new(1);
    let other = lab.candidate(&lab.place());
    let looks = || lab.runtime.block_on(other.campaign()).unwrap();
    let (won, tenure, mut store) = lab.wins(&lab.place());
    store.load().unwrap();
    let lead = tenure.lead().clone();
    let mut watchdog = crate::watchdog::Watchdog::of("another one sees its beats");
    let follows = |campaign| match campaign {
        Campaign::Follows { leader, beats } => (leader, beats),
        Campaign::Won(next) => panic!("{next:?} leads beside {won:?}"),
    };
    while !follows(looks()).1 {
        watchdog.saw("no beat");
        thread::sleep(Duration::from_millis(20));
    }
    // It does not say any more that it is there, and believes in its lead as long as it may.
    drop(tenure);
    let next = loop {
        match looks() {
            Campaign::Won(next) => break next,
            Campaign::Follows { .. } => thread::sleep(Duration::from_millis(20)),
        }
    };
    assert!(is_lost(&lead) && next.term > won.term, "{next:?} after {won:?}");
    let refused = store.append(&kinds::records()[..1]).unwrap_err();
    assert_eq!(refused.unusable, Unusable::NotLeading, "{refused}");
}

#[test]
#[ignore = "needs etcd: ./tests/run etcd"]
fn a_beat_that_comes_late_keeps_nothing_and_takes_nothing() {
    let lab = Lab::new(1);
    let (first, second) = (lab.candidate(&lab.place()), lab.candidate(&lab.place()));
    let wins = |candidate: &Candidate| match lab.runtime.block_on(candidate.campaign()).unwrap() {
        Campaign::Won(won) => won,
        Campaign::Follows { leader, .. } => panic!("{leader:?} leads"),
    };
    let beat = |candidate: &Candidate, won| lab.runtime.block_on(candidate.beat(won, TTL)).ok().unwrap();
    let resigns = |won| lab.runtime.block_on(first.resign(won)).map_err(|bad| bad.why).unwrap();
    let before = wins(&first);
    resigns(&before);
    // It was on its way when the lead was let go: nobody waits for a lease that it would begin.
    assert!(beat(&first, &before).is_err());
    let after = wins(&second);
    assert!(beat(&first, &before).is_err());
    resigns(&before);
    assert!(beat(&second, &after).is_ok(), "it leads as before");
}

#[test]
#[ignore = "needs etcd: ./tests/run etcd"]
fn a_place_that_was_emptied_is_led_by_nobody_who_has_seen_more_there() {
    let mut lab = Lab::new(1);
    drop(written(&mut lab));
    let mine = lab.candidate(&lab.place());
    let campaigns = |candidate: &Candidate| lab.runtime.block_on(candidate.campaign());
    assert!(matches!(campaigns(&mine).unwrap(), Campaign::Follows { .. }));
    let lead = lab.leader.as_ref().unwrap().lead().clone();
    lab.does(vec![delete(Span(format!("{PREFIX}/").into(), format!("{PREFIX}0").into()))]);
    let why = lab.runtime.block_on(lead.lost());
    assert_eq!(why, "its keys in etcd are gone");
    let refused = campaigns(&mine).unwrap_err();
    assert_eq!(refused.unusable, Unusable::Damaged, "{refused}");
    assert!(refused.why.contains("it was emptied"), "{refused}");
    assert!(lab.content().is_empty(), "nothing was written");
    assert!(matches!(campaigns(&lab.candidate(&lab.place())).unwrap(), Campaign::Won(_)), "a new GCM leads");
}

#[test]
#[ignore = "needs etcd: ./tests/run etcd"]
fn etcd_forgets_what_beats_leave_behind() {
    let lab = Lab::new(1);
    let (client, candidate) = (Client::new(&lab.place().parse().unwrap()), lab.candidate(&lab.place()));
    let Campaign::Won(won) = lab.runtime.block_on(candidate.campaign()).unwrap() else { panic!("it leads") };
    let beat = || lab.runtime.block_on(candidate.beat(&won, TTL)).ok().unwrap().unwrap();
    let (old, new) = (beat(), beat());
    let at = |revision| {
        let leader = read(Span(keys().leader(), Vec::new()), 0, revision);
        lab.runtime.block_on(client.range(leader, WITHIN)).map(|(found, _)| found.len())
    };
    assert_eq!(at(old).ok(), Some(1));
    for _ in 0..2 {
        lab.runtime.block_on(client.compact(new, WITHIN)).map_err(|bad| bad.why).unwrap();
    }
    assert!(at(old).is_err() && at(new).is_ok());
}

#[test]
#[ignore = "needs etcd: ./tests/run etcd"]
fn a_lead_that_is_not_confirmed_ends_before_another_has_it() {
    let mut lab = Lab::new(1);
    let (_, tenure, mut store) = lab.wins(&lab.place());
    store.load().unwrap();
    lab.cluster.kill(0);
    let lead = tenure.lead().clone();
    while !is_lost(&lead) {
        thread::sleep(Duration::from_millis(20));
    }
    let refused = store.append(&kinds::records()).unwrap_err();
    assert_eq!(refused.unusable, Unusable::Now, "{refused}");
    assert!(refused.why.contains("etcdctl endpoint health"), "{refused}");
    assert!(refused.file.display().to_string().ends_with(PREFIX), "{refused}");
    lab.cluster.restart(0);
    // Either the lease is still there, and the lead with it, or it has ended.
    loop {
        match store.append(&kinds::records()) {
            Ok(()) => break assert_has(&store.load().unwrap(), &kinds::records()),
            Err(e) if e.unusable == Unusable::NotLeading => break,
            Err(e) => assert_eq!(e.unusable, Unusable::Now, "{e}"),
        }
    }
}

#[test]
#[ignore = "needs etcd: ./tests/run etcd"]
fn a_member_that_is_gone_is_passed_by() {
    let (mut lab, records) = (Lab::new(3), kinds::records());
    let mut store = lab.leads();
    store.load().unwrap();
    store.append(&records[..1]).unwrap();
    for gone in 0..3 {
        lab.cluster.kill(gone);
        let mut refused = 0;
        while let Err(e) = store.append(&records[gone + 1..gone + 2]) {
            // The cluster elects another leader of its own.
            refused += 1;
            assert!(e.unusable == Unusable::Now && refused < 20, "{e}");
        }
        lab.cluster.restart(gone);
        while !lab.cluster.is_healthy(gone) {
            thread::sleep(Duration::from_millis(20));
        }
    }
    assert_has(&store.load().unwrap(), &records[..4]);
}

/// A way to etcd that can keep the answers.
struct Proxy {
    address: String,
    is_mute: Arc<AtomicBool>,
}

impl Proxy {
    fn to(target: String) -> Proxy {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let is_mute = Arc::new(AtomicBool::new(false));
        let mute = is_mute.clone();
        // It ends with the process of the tests.
        thread::spawn(move || {
            for near in listener.incoming() {
                let (near, far) = (near.unwrap(), TcpStream::connect(&target).unwrap());
                let (back, forth) = ((far.try_clone().unwrap(), near.try_clone().unwrap()), (near, far));
                let (mute, never) = (mute.clone(), Arc::default());
                thread::spawn(move || pass(back.0, back.1, &mute));
                thread::spawn(move || pass(forth.0, forth.1, &never));
            }
        });
        Proxy { address, is_mute }
    }
}

fn pass(mut from: TcpStream, mut to: TcpStream, is_mute: &AtomicBool) {
    from.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
    let (mut bytes, mut was_mute) = ([0; 4096], false);
    loop {
        match from.read(&mut bytes) {
            Ok(0) => break,
            Ok(count) if !is_mute.load(Ordering::Relaxed) && !was_mute => {
                if to.write_all(&bytes[..count]).is_err() {
                    break;
                }
            }
            Ok(_) => was_mute = true,
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => break,
        }
        // A part of what was said is missing.
        if was_mute && !is_mute.load(Ordering::Relaxed) {
            break;
        }
    }
    let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
}

#[test]
#[ignore = "needs etcd: ./tests/run etcd"]
fn what_was_written_without_an_answer_counts_once() {
    let (lab, records) = (Lab::new(1), kinds::records());
    let proxy = Proxy::to(lab.cluster.address(0));
    let (won, tenure, _) = lab.wins(&lab.place());
    let through = format!("etcd://{}/{PREFIX}", proxy.address).parse().unwrap();
    let mut store = EtcdStore::new(&through, &won, &tenure).unwrap();
    store.load().unwrap();
    store.append(&records[..1]).unwrap();
    let before = lab.content().len();
    proxy.is_mute.store(true, Ordering::Relaxed);
    let unheard = store.append(&records[1..3]).unwrap_err();
    assert_eq!(unheard.unusable, Unusable::Now, "{unheard}");
    assert_eq!(lab.content().len(), before + 2, "it was written all the same");
    proxy.is_mute.store(false, Ordering::Relaxed);
    store.append(&records[1..2]).unwrap();
    store.append(&records[2..5]).unwrap();
    proxy.is_mute.store(true, Ordering::Relaxed);
    let unheard = store.keep(&kinds::snapshot(&records[..5])).unwrap_err();
    assert_eq!(unheard.unusable, Unusable::Now, "{unheard}");
    proxy.is_mute.store(false, Ordering::Relaxed);
    store.append(&records[5..6]).unwrap();
    let read = store.load().unwrap();
    // Whether the snapshot was kept or not, all that was decided is there once.
    assert_eq!(said(&read.records.last()), said(&records.get(5)));
    assert!([1, 6].contains(&read.records.len()), "{} records", read.records.len());
    assert_eq!(fold(&read), kinds::snapshot(&records[..6]).wanted);
}

/// A journal of all records with a snapshot in its middle.
fn written(lab: &mut Lab) -> EtcdStore {
    let records = kinds::records();
    let mut store = lab.leads();
    store.load().unwrap();
    store.append(&records[..5]).unwrap();
    store.keep(&kinds::snapshot(&records[..5])).unwrap();
    store.append(&records[5..]).unwrap();
    store
}

#[test]
#[ignore = "needs etcd: ./tests/run etcd"]
fn what_is_damaged_or_of_a_later_release_is_refused_unharmed() {
    let mut lab = Lab::new(1);
    drop(written(&mut lab));
    let (good, keys) = (lab.content(), keys());
    let of = |key: Vec<u8>| good.iter().find(|(name, _)| *name == key).unwrap().1.clone();
    let flipped = |key: Vec<u8>| {
        let mut value = of(key.clone());
        let middle = value.len() / 2;
        value[middle] ^= 0x20;
        put(key, value)
    };
    let later = |key: Vec<u8>| {
        let record = wire::Record::decode(of(key.clone()).as_slice()).unwrap();
        put(key, wire::Record { schema: SCHEMA + 6, ..record }.encode_to_vec())
    };
    let gone = |key: Vec<u8>| delete(Span(key, Vec::new()));
    let last = keys.record(11, 0);
    let cases = [
        (flipped(keys.record(8, 0)), Unusable::Damaged, "record 8"),
        (flipped(last.clone()), Unusable::Damaged, "record 11"),
        (gone(keys.record(7, 0)), Unusable::Damaged, "record 7: it is missing"),
        (gone(last.clone()), Unusable::Damaged, "record 11: it is missing"),
        (put(keys.record(7, 1), vec![1]), Unusable::Damaged, "record 7"),
        (put(keys.record(7, 2), vec![1]), Unusable::Damaged, "part 1 is missing"),
        (flipped(keys.part(1, 0)), Unusable::Damaged, "another hash"),
        (gone(keys.part(1, 0)), Unusable::Damaged, "it has 0 parts, not 1"),
        (gone(keys.head()), Unusable::Damaged, "it has no head"),
        (gone(keys.identity()), Unusable::Damaged, "not a journal"),
        (put(keys.identity(), b"hello".to_vec()), Unusable::Damaged, "cannot be decoded"),
        (later(last), Unusable::Newer, "schema 7"),
    ];
    for (harm, unusable, why) in cases {
        let what = format!("{harm:?}");
        lab.does(vec![harm]);
        let before = lab.content();
        let refused = lab.leads().load().unwrap_err();
        assert_eq!(refused.unusable, unusable, "{what}: {refused}");
        assert!(refused.why.contains(why), "{what}: {refused}");
        assert!(lab.content() == before, "{what}: something was written");
        lab.does(vec![delete(Span(
            format!("{PREFIX}/records/").into(),
            format!("{PREFIX}/records0").into(),
        ))]);
        for (key, value) in &good {
            lab.does(vec![put(key.clone(), value.clone())]);
        }
        assert_eq!(lab.leads().load().unwrap().records.len(), 6);
    }
}

#[test]
#[ignore = "needs etcd: ./tests/run etcd"]
fn another_writer_is_noticed_and_two_systems_do_not_meet() {
    let mut lab = Lab::new(1);
    let mut store = written(&mut lab);
    let (_, _tenure, mut other) = lab.wins(&lab.cluster.place("lab7/records"));
    assert!(other.load().unwrap().records.is_empty());
    other.append(&kinds::records()[..3]).unwrap();
    store.append(&kinds::records()[..1]).unwrap();
    assert_eq!(store.load().unwrap().records.len(), 7);
    assert_has(&other.load().unwrap(), &kinds::records()[..3]);
    let head = lab.content().into_iter().find(|(key, _)| *key == keys().head()).unwrap();
    lab.does(vec![put(head.0, head.1)]);
    let refused = store.append(&kinds::records()).unwrap_err();
    assert_eq!(refused.unusable, Unusable::Damaged, "{refused}");
    assert!(refused.why.contains("another process wrote it"), "{refused}");
}

#[test]
#[ignore = "needs etcd: ./tests/run etcd"]
fn only_what_the_audit_keeps_lies_there() {
    let (mut lab, records) = (Lab::new(1), kinds::records());
    let bounds = super::super::frame::Bounds { records: 4, bytes: 1 << 20, unfolded: 1 << 30 };
    let mut store = lab.leads().with(bounds);
    store.load().unwrap();
    for _ in 0..3 {
        store.append(&records).unwrap();
        store.keep(&kinds::snapshot(&records)).unwrap();
    }
    let names: Vec<String> =
        lab.content().into_iter().map(|(key, _)| String::from_utf8(key).unwrap()).collect();
    let record = |number: u64| String::from_utf8(keys().record(number, 0)).unwrap();
    let mut expected = vec!["lab7/head".to_owned(), "lab7/identity".to_owned()];
    expected.extend((30..=33).map(record));
    expected.push("lab7/snapshot".to_owned());
    expected.push(String::from_utf8(keys().part(3, 0)).unwrap());
    assert_eq!(names, expected);
}
