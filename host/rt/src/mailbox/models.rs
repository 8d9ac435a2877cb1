//! A push beside the drain, under every interleaving.

use std::sync::Arc;

use super::*;
use crate::loom_models::model_within;
use crate::sync::AtomicBool;

/// A push can learn of room from another one, which was suspended before it claimed anything, without ever
/// having met the drain: then the slot's own sequence alone orders its writing after the drain's reading.
#[test]
fn loom_a_push_that_never_met_the_drain_waits_for_its_slot() {
    model_within(3, || {
        let push = |mail: &Mailbox| mail.push(EntryHead::default(), &[], Overflow::Reject);
        let shared = Arc::new((Mailbox::new(3, 0, 0), AtomicBool::new(false)));
        (0..3).for_each(|_| assert_eq!(push(&shared.0), Push::Queued));
        let theirs = Arc::clone(&shared);
        let server = loom::thread::spawn(move || {
            let (mail, suspended) = &*theirs;
            assert_eq!(mail.drain(|_, _| {}, |_| {}), 3);
            assert_eq!(mail.oldest_for(3), 3);
            // Relaxed on purpose: being told of the suspension brings no order.
            suspended.store(true, Ordering::Relaxed);
        });
        let (mail, suspended) = &*shared;
        if suspended.load(Ordering::Relaxed) {
            let _: [Push; 2] = [push(mail), push(mail)];
        }
        server.join().expect("the server's checks hold");
    });
}
