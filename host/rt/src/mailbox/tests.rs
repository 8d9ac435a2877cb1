//! A close beside a push that stands still.
//!
//! Promise: the close sleeps meanwhile, and leaves no entry behind, nor uncounted where it cannot wait for
//! it.

use std::sync::mpsc;

use super::*;

/// Most looks at what should happen at once.
const LOOKS: u32 = 500_000;

fn sleeps(tid: i32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/self/task/{tid}/stat")).unwrap_or_default();
    stat.rsplit_once(") ").is_some_and(|(_, rest)| rest.starts_with('S'))
}

/// A push that was suspended under a thread of higher priority would never go on while that thread spins.
#[test]
fn a_close_sleeps_while_a_push_is_suspended_in_its_copying_and_takes_its_entry_afterwards() {
    let mail = Mailbox::new(2, 8, 0);
    let head = EntryHead { reply: 7, ..EntryHead::default() };
    assert!(mail.claim_tail(0), "a push that was suspended here");
    let (tell, told) = mpsc::channel();
    std::thread::scope(|scope| {
        let closer = scope.spawn(|| {
            // SAFETY: asks for the number of the calling thread.
            tell.send(unsafe { libc::gettid() }).expect("the test listens");
            let mut dropped = Vec::new();
            mail.close(|head| dropped.push(head));
            dropped
        });
        let tid = told.recv().expect("the thread begins");
        // Asleep at each of several looks in a row; a thread that spins or yields is ready to run.
        let (mut asleep, mut looks) = (0, 0);
        while asleep < 50 && looks < LOOKS {
            asleep = if sleeps(tid) { asleep + 1 } else { 0 };
            looks += 1;
        }
        let left = closer.is_finished();
        // Also where it fails, or the test would not end.
        mail.fill(0, head, &[0; 8], Overflow::Reject);
        assert!(!left, "it leaves the entry behind");
        assert_eq!(asleep, 50, "it keeps its processor from the push it waits for");
        assert_eq!(closer.join().expect("it closes"), [head]);
    });
    assert!(mail.is_empty());
    assert_eq!(mail.push(head, &[], Overflow::Reject), Push::Closed);
}

#[test]
fn a_sealed_mailbox_refuses_pushes_and_gives_what_was_queued_also_by_a_push_under_way() {
    let mail = Mailbox::new(4, 8, 0);
    let head = EntryHead { reply: 7, ..EntryHead::default() };
    assert_eq!(mail.push(head, &[1], Overflow::Reject), Push::Queued);
    assert!(mail.claim_tail(1), "a push that was suspended here");
    mail.seal();
    mail.seal();
    assert_eq!(mail.push(head, &[], Overflow::Reject), Push::Closed);
    let mut seen = Vec::new();
    mail.drain(|_, bytes| seen.push(bytes.to_vec()), |_| ());
    assert!(!mail.is_empty(), "it waits for the push");
    mail.fill(1, head, &[2], Overflow::Reject);
    mail.drain(|_, bytes| seen.push(bytes.to_vec()), |_| ());
    assert_eq!(seen, [[1], [2]]);
    assert!(mail.is_empty());
}

/// Another process may never go on; if it does, it is told that its entry is queued.
#[test]
fn a_close_that_cannot_wait_for_another_process_hands_out_what_that_has_not_written_and_all_behind_it() {
    let mut mail = Mailbox::new(4, 8, 0);
    mail.scope = Scope::Machine;
    let head = |reply| EntryHead { reply, ..EntryHead::default() };
    assert_eq!(mail.push(head(1), &[], Overflow::Reject), Push::Queued);
    assert!(mail.claim_tail(1), "a push that was suspended here");
    assert_eq!(mail.push(head(3), &[], Overflow::Reject), Push::Queued);
    let mut dropped = Vec::new();
    mail.close(|head| dropped.push(head));
    assert_eq!(dropped, [head(1), EntryHead::default(), head(3)]);
    assert_eq!(mail.stats().dropped, 3);
    mail.fill(1, head(2), &[0; 8], Overflow::Reject);
    assert_eq!(mail.drain(|_, _| {}, |_| {}), 0, "who comes on late is not run: it was counted");
}

/// An entry in the hands of a drain runs: it is not handed out as well.
#[test]
fn a_close_that_cannot_wait_for_a_drain_leaves_it_the_entry_it_has_in_hand() {
    let mut mail = Mailbox::new(4, 8, 0);
    mail.scope = Scope::Machine;
    let head = |reply| EntryHead { reply, ..EntryHead::default() };
    for reply in [1, 2] {
        assert_eq!(mail.push(head(reply), &[], Overflow::Reject), Push::Queued);
    }
    assert!(mail.claim(0), "a drain that was suspended here");
    let mut dropped = Vec::new();
    mail.close(|head| dropped.push(head));
    assert_eq!(dropped, [head(2)]);
}
