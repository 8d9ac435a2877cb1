//! Mistakes a plugin may make: pointers to nothing, structs of another size, loans and views of another
//! component.

use std::ffi::c_void;
use std::ptr::{null, null_mut};

use serde_json::{Value, json};
use trocar_plugin_api::abi::*;

use super::commands::{POKE, SET, TWICE, VALUE, client, obeys, server};
use super::script::*;
use super::world::*;

fn frames(header: &str) -> Value {
    json!({"frame": header, "format": "image", "max_bytes": 64})
}

/// A call with exactly these pointers.
fn raw(
    stage: &Stage,
    function: usize,
    arg: *const u64,
    ret: *mut u64,
    opts: Option<&mut CallOpts>,
) -> Outcome {
    let slot = stage.function(function);
    let opts = opts.map_or(null_mut(), std::ptr::from_mut);
    // SAFETY: a slot of the stage; every pointer that is not null has the right size behind it.
    unsafe { (slot.call)(slot.ctx, arg.cast(), ret.cast(), opts) }
}

fn waiting() -> CallOpts {
    CallOpts {
        struct_size: size_of::<CallOpts>() as u32,
        mode: MODE_CALL,
        deadline_ns: 5_000_000_000,
        err: null_mut(),
        stamp_ns: 7,
        may_still_run: 9,
        reserved: 0,
    }
}

#[test]
fn an_argument_or_result_that_points_nowhere_is_invalid_and_a_send_needs_no_result() {
    let world = World::new("nowhere");
    let client = world.active("client", &client(false), on_signal(), Script::default());
    world.active("near", &server(), passive(), obeys());
    world.active("far", &server(), on_signal(), obeys());
    for (name, sent) in [("near", EXECUTED), ("far", QUEUED)] {
        let connection = world.connect("client/peer", &format!("{name}/ctl"));
        let (arg, mut ret) = (21u64, 0u64);
        assert_eq!(raw(client, SET, null(), null_mut(), None), INVALID_ARGUMENT, "{name}");
        assert_eq!(raw(client, TWICE, null(), &mut ret, Some(&mut waiting())), INVALID_ARGUMENT, "{name}");
        assert_eq!(raw(client, TWICE, &arg, null_mut(), Some(&mut waiting())), INVALID_ARGUMENT, "{name}");
        assert_eq!(raw(client, TWICE, &arg, null_mut(), None), sent, "{name}: the result has its own place");
        assert_eq!(raw(client, TWICE, &arg, &mut ret, Some(&mut waiting())), EXECUTED, "{name}");
        assert_eq!(ret, 42);
        for opts in [None, Some(&mut waiting())] {
            assert_eq!(raw(client, VALUE, null(), null_mut(), opts), INVALID_ARGUMENT, "{name}: a read");
        }
        assert_eq!(raw(client, POKE, null(), null_mut(), None), sent, "{name}: it has neither");
        world.cut(&connection);
    }
}

#[test]
fn a_read_of_the_system_interface_without_a_place_for_it_is_invalid() {
    let world = World::new("no-place");
    let asker = json!({"required": [{"name": "peer", "functions": [{"name": "GetState", "any": true}]}]});
    let asker = world.active("asker", &asker, on_signal(), Script::default());
    world.active("asked", &server(), on_signal(), obeys());
    world.connect("asker/peer", "asked/system");
    assert_eq!(raw(asker, 0, null(), null_mut(), None), INVALID_ARGUMENT);
    assert_eq!(raw(asker, 0, null(), null_mut(), Some(&mut waiting())), INVALID_ARGUMENT);
    let mut row = [0u64; trocar_loader::system::MAX_BYTES / 8];
    assert_eq!(raw(asker, 0, null(), row.as_mut_ptr(), None), EXECUTED);
    assert!(crate::boundary::as_bytes(&row).windows(6).any(|w| w == b"ACTIVE"));
}

#[test]
fn options_are_read_and_written_only_as_far_as_their_size_reaches() {
    let world = World::new("short");
    let client = world.active("client", &client(false), on_signal(), Script::default());
    world.active("server", &server(), on_signal(), obeys());
    world.connect("client/peer", "server/ctl");
    let (arg, mut ret) = (4u64, 0u64);
    // The error buffer lies behind the size: an address that must not be followed.
    let mut opts = CallOpts { struct_size: 16, err: std::ptr::dangling_mut::<ErrBuf>(), ..waiting() };
    assert_eq!(raw(client, TWICE, &arg, &mut ret, Some(&mut opts)), EXECUTED);
    assert_eq!((ret, opts.stamp_ns, opts.may_still_run), (8, 7, 9), "nothing behind its size was written");
    let mut opts = CallOpts { struct_size: 4, err: std::ptr::dangling_mut::<ErrBuf>(), ..waiting() };
    assert_eq!(raw(client, TWICE, &arg, &mut ret, Some(&mut opts)), QUEUED, "without a mode it is a send");
    let mut opts = CallOpts { struct_size: 32, ..waiting() };
    assert_eq!(raw(client, VALUE, null(), &mut ret, Some(&mut opts)), EXECUTED);
    assert_ne!(opts.stamp_ns, 7, "a read says of when it is, where there is a place for it");
    assert_eq!(opts.may_still_run, 9);
    let mut nowhere = ErrBuf { ptr: null_mut(), cap: 100, len: 0 };
    let mut opts = CallOpts { err: &raw mut nowhere, ..waiting() };
    assert_eq!(raw(client, TWICE, &13, &mut ret, Some(&mut opts)), FAILED, "its sentence has no place");
}

#[test]
fn a_payload_or_value_that_points_nowhere_is_invalid() {
    let world = World::new("no-value");
    let ports =
        json!({"provided": server()["provided"], "outputs": [{"name": "out", "type": {"plain": "u64"}}]});
    let source = world.active("source", &ports, on_signal(), obeys());
    let slot = source.output(0);
    // SAFETY: slots of this instance; null pointers are what is tested.
    unsafe {
        assert_eq!((slot.write)(slot.ctx, null(), 0), INVALID_ARGUMENT);
        for bytes in [Bytes { ptr: null(), len: 8 }, Bytes { ptr: 8 as *const u8, len: usize::MAX }] {
            assert_eq!((slot.write_bytes)(slot.ctx, bytes, 0), INVALID_ARGUMENT);
        }
        let event = source.event(0);
        assert_eq!((event.emit)(event.ctx, null()), INVALID_ARGUMENT);
        assert_eq!((slot.type_of)(slot.ctx, null()), STATUS_UNSUPPORTED);
    }
}

#[test]
fn a_loan_is_taken_back_once_and_only_by_the_output_it_came_from() {
    let world = World::new("loans");
    let ports =
        json!({"outputs": [{"name": "a", "type": frames("u64")}, {"name": "b", "type": frames("u64")}]});
    let source = world.active("source", &ports, on_signal(), Script::default());
    let sink = json!({"inputs": [{"name": "in", "type": frames("u64")}]});
    let sink = world.active("sink", &sink, on_signal(), Script::default());
    world.connect("sink/in", "source/a");
    let (a, b) = (source.output(0), source.output(1));
    let lend = |slot: &OutSlot| {
        let mut loan = Loan::EMPTY;
        // SAFETY: a slot of this instance.
        assert_eq!(unsafe { (slot.loan)(slot.ctx, &mut loan) }, EXECUTED);
        loan
    };
    let copy = |loan: &Loan| Loan { token: loan.token, ..Loan::EMPTY };
    // SAFETY: slots of this instance, and loans of the right size, whatever is in them.
    let commit = |slot: &OutSlot, mut loan: Loan, len| unsafe { (slot.commit)(slot.ctx, &mut loan, len, 0) };
    let loan = lend(a);
    let (again, elsewhere) = (copy(&loan), copy(&loan));
    assert_eq!(commit(b, elsewhere, 1), INVALID_ARGUMENT, "not lent by b");
    assert_eq!(commit(a, loan, 1), EXECUTED);
    assert_eq!(commit(a, again, 1), INVALID_ARGUMENT, "committed already");
    assert!(sink.next(0, 8).is_some());
    for garbage in [0, 1, 8, u64::MAX, 0x0000_7fff_dead_beef] {
        assert_eq!(commit(a, Loan { token: garbage, ..Loan::EMPTY }, 0), INVALID_ARGUMENT);
    }
    assert_eq!(commit(a, lend(a), 65), INVALID_ARGUMENT, "longer than its room");
    let small = Loan { struct_size: 8, ..lend(a) };
    assert_eq!(commit(a, Loan { struct_size: 8, token: small.token, ..Loan::EMPTY }, 1), INVALID_ARGUMENT);
    // SAFETY: as above.
    unsafe {
        (a.cancel)(a.ctx, null_mut());
        (a.cancel)(a.ctx, &mut Loan { token: small.token, ..Loan::EMPTY });
        (a.cancel)(a.ctx, &mut Loan { token: small.token, ..Loan::EMPTY });
        assert_eq!((a.loan)(a.ctx, null_mut()), INVALID_ARGUMENT);
        assert_eq!((a.loan)(a.ctx, &mut Loan { struct_size: 16, ..Loan::EMPTY }), INVALID_ARGUMENT);
        assert_eq!((a.commit)(a.ctx, null_mut(), 0, 0), INVALID_ARGUMENT);
    }
    let lent: Vec<Loan> = (0..8).map(|_| lend(a)).collect();
    let mut none = Loan::EMPTY;
    // SAFETY: as above.
    assert_eq!(unsafe { (a.loan)(a.ctx, &raw mut none) }, EXHAUSTED, "every slot came back before");
    // SAFETY: as above.
    assert_eq!(unsafe { (a.reserve)(a.ctx, 64, 2) }, EXECUTED);
    for loan in lent {
        assert_eq!(commit(a, loan, 2), EXECUTED, "lent before the pool was made anew");
    }
}

#[test]
fn a_view_is_good_only_for_what_its_own_input_shows() {
    let world = World::new("views");
    let source = json!({"outputs": [{"name": "out", "type": frames("u64")}]});
    let source = world.active("source", &source, on_signal(), Script::default());
    let relay = json!({"inputs": [{"name": "a", "type": frames("u64")}, {"name": "b", "type": frames("u64")}],
        "outputs": [{"name": "out", "type": frames("u64")}]});
    let relay = world.active("relay", &relay, on_signal(), Script::default());
    let other = world.active(
        "other",
        &json!({"inputs": [{"name": "in", "type": frames("u64")}]}),
        on_signal(),
        Script::default(),
    );
    let sink = world.active(
        "sink",
        &json!({"inputs": [{"name": "in", "type": frames("u64")}]}),
        on_signal(),
        Script::default(),
    );
    for (to, from) in [
        ("relay/a", "source/out"),
        ("relay/b", "source/out"),
        ("other/in", "source/out"),
        ("sink/in", "relay/out"),
    ] {
        world.connect(to, from);
    }
    assert_eq!(source.frame(0, 1, b"frame"), EXECUTED);
    let show = |stage: &Stage, input: usize| {
        let (slot, mut view) = (stage.input(input), SampleView::EMPTY);
        // SAFETY: a slot of this instance.
        assert_eq!(unsafe { (slot.latest)(slot.ctx, &mut view) }, IN_SAMPLE);
        view
    };
    // SAFETY: slots of the relay, and views of the right size, whatever is in them.
    let writable = |input: usize, mut view: SampleView| unsafe {
        let slot: &InSlot = relay.input(input);
        !(slot.writable)(slot.ctx, &mut view).is_null()
    };
    let release = |stage: &Stage, input: usize| {
        let slot = stage.input(input);
        // SAFETY: a slot of this instance.
        unsafe { (slot.release)(slot.ctx) };
    };
    let (a, foreign) = (show(relay, 0), show(other, 0));
    assert_eq!(relay.forward(0, &foreign), INVALID_ARGUMENT, "another component's");
    release(other, 0);
    let b = show(relay, 1);
    release(relay, 1);
    assert!(writable(0, a), "its only owner now");
    assert!(!writable(0, b), "the view of another input");
    assert_eq!(relay.forward(0, &b), INVALID_ARGUMENT, "nothing is shown there any more");
    for token in [0, 1, 64, u64::MAX] {
        assert_eq!(relay.forward(0, &SampleView { token, ..a }), INVALID_ARGUMENT);
        assert!(!writable(0, SampleView { token, ..a }));
    }
    assert_eq!(relay.forward(0, &SampleView { struct_size: 16, ..a }), INVALID_ARGUMENT);
    assert_eq!(relay.forward(0, &a), EXECUTED);
    assert_eq!(sink.next(0, 8).unwrap().bytes, b"frame");
    let (slot, out) = (relay.input(0), relay.output(0));
    // SAFETY: slots of this instance; null pointers are what is tested.
    unsafe {
        assert_eq!((slot.latest)(slot.ctx, null_mut()), INVALID_ARGUMENT);
        assert_eq!(
            (slot.next)(slot.ctx, &mut SampleView { struct_size: 4, ..SampleView::EMPTY }),
            INVALID_ARGUMENT
        );
        assert!((slot.writable)(slot.ctx, null_mut::<SampleView>()).is_null());
        assert_eq!((out.forward)(out.ctx, null::<c_void>().cast(), 0), INVALID_ARGUMENT);
    }
}

#[test]
fn a_read_that_panics_is_told_to_its_caller_and_named_and_the_component_goes_on() {
    let world = World::new("panics");
    let client = world.active("client", &client(false), on_signal(), Script::default());
    world.active("server", &server(), on_signal(), obeys());
    world.connect("client/peer", "server/ctl");
    assert_eq!(client.ask(TWICE, 1).outcome, EXECUTED);
    assert_eq!(client.send(SET, READ_PANICS), QUEUED);
    assert_eq!(client.ask(TWICE, 1).outcome, EXECUTED, "the state is out by now");
    for _ in 0..3 {
        let failed = client.ask(VALUE, 0);
        assert_eq!((failed.outcome, failed.text.as_str()), (FAILED, "as the test wants"));
    }
    let instance = world.instance("server");
    eventually("being named", || {
        let said = |w: &String| w.contains("its reads panicked") && w.contains("value: as the test wants");
        instance.warnings().iter().any(said)
    });
    assert_eq!(instance.state(), trocar_model::State::Active, "nobody was inside");
    assert_eq!(client.send(SET, 5), QUEUED);
    assert_eq!(client.ask(TWICE, 1).outcome, EXECUTED);
    assert_eq!(client.ask(VALUE, 0).ret, 5);
}

#[test]
fn a_state_that_is_no_value_of_its_type_is_refused_by_component_field_and_reason_at_any_time() {
    use crate::{Lcm, When};
    let world = World::new("no-value");
    let robot = world.active("robot", &json!({"state": {"ref": "Named"}}), on_signal(), Script::default());
    // The value is the length of a text that has room for 8 bytes.
    robot.state.store(99, std::sync::atomic::Ordering::SeqCst);
    world.run("robot", trocar_model::Verb::Stop).unwrap();
    world.run("robot", trocar_model::Verb::Resume).unwrap();
    let rows = &world.instance("robot").rows;
    let stamp = |k| rows.delayed(k, &mut [0; 16]).unwrap().stamp_ns;
    let between = stamp(1) + (stamp(0) - stamp(1)) / 2;
    for when in [When::Newest, When::Delayed(0), When::Nearest(stamp(0)), When::Time(between)] {
        let until = std::time::Instant::now() + PATIENCE;
        let refusal = world.wait(world.lcm.read("no-value/robot".into(), when, false, until)).unwrap_err();
        assert_eq!(refusal.reason(), "COMPONENT_REFUSED", "{when:?}: {refusal}");
        let text = refusal.to_string();
        let says = |part: &str| assert!(text.contains(part), "{when:?}: {part}: {text}");
        ["no-value/robot", "/label", "its length says 99"].into_iter().for_each(says);
    }
}

#[test]
fn frame_pools_are_locked_into_memory_once_or_it_is_said_why_not() {
    let world = World::new("locked");
    let source = json!({"outputs": [{"name": "out", "type": frames("u64")}]});
    let source = world.active("source", &source, on_signal(), Script::default());
    let instance = world.instance("source");
    instance.lock_pools();
    let said = instance.warnings().iter().any(|w| w.contains("the frames of out are not locked into memory"));
    let slot = source.output(0);
    let mut loan = Loan::EMPTY;
    // SAFETY: a slot of this instance.
    assert_eq!(unsafe { (slot.loan)(slot.ctx, &mut loan) }, EXECUTED);
    assert_ne!(locked_kib(loan.bytes.addr()) > 0, said, "either locked or said");
    // SAFETY: as above.
    unsafe { (slot.cancel)(slot.ctx, &mut loan) };
    let warnings = instance.warnings();
    instance.lock_pools();
    assert_eq!(instance.warnings(), warnings, "it is asked for once");
}

/// Locked part of the mapping at that address, KiB.
fn locked_kib(address: usize) -> u64 {
    let maps = std::fs::read_to_string("/proc/self/smaps").unwrap();
    let mut here = false;
    for line in maps.lines() {
        let range = line.split(' ').next().and_then(|r| r.split_once('-'));
        let range = range.map(|(a, b)| [a, b].map(|x| usize::from_str_radix(x, 16)));
        if let Some([Ok(from), Ok(to)]) = range {
            here = (from..to).contains(&address);
        } else if let Some(locked) = line.strip_prefix("Locked:").filter(|_| here) {
            return locked.trim().trim_end_matches(" kB").parse().unwrap();
        }
    }
    panic!("{address:#x} is not mapped")
}
