//! A system with each kind of entry and answer, and its way through the codec.

use std::sync::Arc;

use serde_json::json;
use trocar_lcm_api::Report;
use trocar_model::{
    Change, ClassInfo, Component, ComponentId, ConnectOptions, Connection, ConnectionId, Entry, Execution,
    ExecutionModel, Grant, Health, Incarnation, Name, Plan, PortId, Ports, Queue, Refusal, Skipped, State,
    StopReason, Target, Verb, Wanted, WantedComponent,
};

use super::super::chain::Hash;
use super::super::codec;
use super::said;
use crate::gcm::{Answer, Asked, Executed, Record, Remembered, Snapshot};

pub(super) fn id(path: &str) -> ComponentId {
    ComponentId::parse(path).unwrap()
}

fn class(name: &str) -> Arc<ClassInfo> {
    Arc::new(ClassInfo {
        name: name.to_owned(),
        // 2^60 + 1 and 1.0: neither comes back out of a double as it was.
        config_schema: json!({ "maximum": 1_152_921_504_606_846_977_u64, "minimum": 1.0, "x": [0.1, 1e-7] }),
        ..(*crate::gcm::fake::class()).clone()
    })
}

fn execution() -> Execution {
    Execution {
        model: Some(ExecutionModel::Periodic),
        period_ns: Some(1_000_001),
        priority: Some(80),
        cpus: vec![1, 3],
        ..Execution::default()
    }
}

fn component(state: State) -> Component {
    let class = class("Arm");
    Component {
        ports: Arc::new(class.ports.clone()),
        class,
        config: json!({ "gain": 0.1 + 0.2, "big": u64::MAX, "name": "µ\u{1b}[0m" }),
        execution: execution(),
        state,
        health: Health::Ok,
        fault: String::new(),
    }
}

fn connection(number: u64) -> Connection {
    let port = |path: &str| PortId::parse(path).unwrap();
    Connection {
        id: ConnectionId(number),
        client: port("host/arm/in"),
        server: port("host/eye/out"),
        options: ConnectOptions {
            queue: Some(Queue::Fifo { depth: 7, drop_oldest: true }),
            max_age_ns: Some(3_000_000_001),
            delay: true,
            ..ConnectOptions::default()
        },
    }
}

fn changes() -> Vec<Change> {
    let (arm, eye) = (id("host/arm"), id("host/eye"));
    let run = |verb, from, to| Change::Run { id: arm.clone(), verb, from, to };
    vec![
        Change::Create { id: arm.clone(), component: Box::new(component(State::Created)) },
        Change::Create {
            id: eye.clone(),
            component: Box::new(Component { class: class("Eye"), ..component(State::Created) }),
        },
        Change::Configure {
            id: arm.clone(),
            from: json!({}),
            to: json!({ "gain": 1e-300 }),
            from_state: State::Created,
            to_state: State::Ready,
        },
        Change::Connect { connection: connection(4) },
        run(Verb::Start, State::Ready, State::Active),
        run(Verb::Stop, State::Active, State::Stopped(StopReason::Requested)),
        run(Verb::Resume, State::Stopped(StopReason::Interlock), State::Active),
        run(Verb::Reset, State::Fault, State::Ready),
        run(Verb::Start, State::Ready, State::Active),
        Change::Disconnect { connection: connection(4), replaced: true },
        Change::Connect { connection: connection(5) },
        Change::Destroy { id: eye, component: Box::new(component(State::Ready)) },
    ]
}

fn report(ports: Option<Arc<Ports>>) -> Report {
    Report {
        id: id("host/arm"),
        number: 9,
        state: State::Active,
        health: Health::StaleInput,
        fault: String::new(),
        ports,
        lost_connections: vec![3],
        warnings: vec!["no real time: the limit is 0".into()],
    }
}

fn done(revision: u64, changes: Vec<Change>) -> Answer {
    let skipped = vec![Skipped { id: id("host/eye"), why: "is READY".into() }];
    let refused = Refusal::RevisionConflict { expected: 3, actual: 4 };
    Ok(Executed {
        revision,
        plan: Plan { changes, skipped },
        reports: vec![report(None)],
        failed: vec![(Target::everything(), refused.clone()), (Target::One(id("host/arm")), refused)],
        left: vec!["host/eye has another class".into()],
    })
}

fn asked(request_id: &str, text: &str) -> Asked {
    let hash = if request_id.is_empty() { [0; 32] } else { [7; 32] };
    Asked { identity: "uid 1000".into(), request_id: request_id.into(), hash, text: text.into() }
}

fn wanted(state: State, grant: Option<Grant>) -> WantedComponent {
    WantedComponent { state, grant, ..WantedComponent::from(&component(state)) }
}

fn grant() -> Grant {
    Grant { verb: Verb::Resume, revision: 3, decision: 2, epoch: 12 }
}

/// Records with each kind of entry, with and without an answer, in an order that could be.
pub(in crate::journal) fn records() -> Vec<Record> {
    let came = |name: &str, epoch| Entry::Came {
        process: Name::parse(name).unwrap(),
        incarnation: Incarnation { instance: u128::from(epoch) << 100 | 5, epoch },
    };
    let brought = Entry::Brought {
        revision: 3,
        process: Name::parse("left").unwrap(),
        components: vec![
            (id("left/a"), wanted(State::Active, Some(grant()))),
            (id("left/b"), wanted(State::Ready, None)),
        ],
        connections: vec![connection(9)],
    };
    let stop = Target::parse("host/**").unwrap();
    let stopped = vec![Change::Run {
        id: id("host/arm"),
        verb: Verb::Stop,
        from: State::Active,
        to: State::Stopped(StopReason::Requested),
    }];
    let refusal = Refusal::RevisionConflict { expected: 3, actual: 4 };
    let entries: Vec<(Entry, Option<Asked>, Option<Answer>)> = vec![
        (Entry::Noted, None, None),
        (came("host", 11), None, None),
        (
            Entry::Changed { revision: 1, decision: 1, changes: changes() },
            Some(asked("a-1", r#"{"apply":{"steps":[]}}"#)),
            Some(done(1, changes())),
        ),
        (Entry::Noted, Some(asked("", r#"{"start":{"paths":["#)), Some(Err(refusal))),
        (came("left", 12), None, None),
        (brought, None, None),
        (
            Entry::Stopped { revision: 4, decision: 2, targets: vec![stop, Target::One(id("left/a"))] },
            Some(asked("", r#"{"stop":{"paths":["host/**","left/a"]}}"#)),
            Some(done(4, stopped)),
        ),
        (Entry::Failed { component: id("left/a") }, None, None),
        (Entry::Cut { revision: 5, connections: vec![ConnectionId(9), ConnectionId(5)] }, None, None),
        (Entry::Changed { revision: 6, decision: 3, changes: changes()[4..5].to_vec() }, None, None),
        (
            Entry::Gone { revision: 7, process: Name::parse("left").unwrap(), epoch: 12 },
            Some(asked("", r#"{"forget":{"process":"left"}}"#)),
            Some(done(7, Vec::new())),
        ),
    ];
    let mut number = 0;
    let record = |(entry, asked, answer)| {
        number += 1;
        Record {
            wall_ns: 1_767_225_600_000_000_000 + number * 1_234_000_000,
            monotonic_ns: number * 1_234_000_000,
            term: 1 + number / 5,
            entry,
            asked,
            answer,
        }
    };
    entries.into_iter().map(record).collect()
}

/// A snapshot of the first records, with answers.
pub(in crate::journal) fn snapshot(records: &[Record]) -> Snapshot {
    let mut wanted = Wanted::default();
    records.iter().for_each(|record| wanted.on(&record.entry));
    wanted.term = records.last().map_or(0, |record| record.term);
    let remembered = |record: &Record| {
        let asked = record.asked.clone()?;
        Some(Remembered { wall_ns: record.wall_ns, asked, answer: record.answer.clone()? })
    };
    Snapshot { wanted, answers: records.iter().filter_map(remembered).collect() }
}

#[test]
fn records_of_each_kind_come_back_as_they_were() {
    let origin = Hash::of(b"origin");
    for (at, record) in records().iter().enumerate() {
        let linked = codec::record_in(&codec::record(record, at as u64 + 1, &origin)).unwrap();
        assert_eq!((linked.number, linked.before), (at as u64 + 1, origin));
        assert_eq!(linked.record.entry, record.entry);
        assert_eq!(said(&linked.record), said(record));
        let plans =
            |record: &Record| record.answer.clone().and_then(Result::ok).map(|it| (it.plan, it.reports));
        assert_eq!(plans(&linked.record), plans(record));
    }
}

#[test]
fn every_refusal_is_kept_with_its_values() {
    for refusal in Refusal::examples() {
        let answer = Some(Err(refusal.clone()));
        let record = Record { answer, ..records().remove(0) };
        let linked = codec::record_in(&codec::record(&record, 1, &Hash::of(b""))).unwrap();
        assert_eq!(linked.record.answer.unwrap().unwrap_err(), refusal);
    }
}

#[test]
fn a_snapshot_comes_back_as_it_was() {
    let records = records();
    for upto in 0..=records.len() {
        let snapshot = snapshot(&records[..upto]);
        let hash = Hash::of(b"head");
        let folded = codec::snapshot_in(&codec::snapshot(&snapshot, 7, &hash)).unwrap();
        assert_eq!((folded.number, folded.hash), (7, hash));
        assert_eq!(folded.snapshot.wanted, snapshot.wanted);
        assert_eq!(said(&folded.snapshot), said(&snapshot));
    }
}

#[test]
fn a_class_that_many_components_have_is_written_once_and_ports_of_reports_are_not() {
    let arm = class("Arm");
    let one = |at: usize| Change::Create {
        id: id(&format!("host/arm{at}")),
        component: Box::new(Component { class: Arc::new((*arm).clone()), ..component(State::Created) }),
    };
    let record = |changes: Vec<Change>, ports| {
        let executed = Executed { revision: 1, reports: vec![report(ports)], ..Executed::default() };
        let entry = Entry::Changed { revision: 1, decision: 1, changes };
        Record { entry, answer: Some(Ok(executed)), ..records().remove(0) }
    };
    let length = |record: &Record| codec::record(record, 1, &Hash::of(b"")).len();
    let single = length(&record(vec![one(0)], None));
    let many = record((0..100).map(one).collect(), Some(Arc::new(arm.ports.clone())));
    assert!(length(&many) < single + 100 * 300, "{} bytes for 100, {single} for one", length(&many));
    let linked = codec::record_in(&codec::record(&many, 1, &Hash::of(b""))).unwrap();
    assert_eq!(linked.record.answer.unwrap().unwrap().reports, [report(None)]);
}

proptest::proptest! {
    #[test]
    fn bytes_that_are_no_record_are_refused_without_a_panic(at in 0usize..11, byte: proptest::sample::Index, bit in 0u8..8) {
        let mut bytes = codec::record(&records()[at], 1, &Hash::of(b""));
        let place = byte.index(bytes.len());
        bytes[place] ^= 1 << bit;
        let _ = codec::record_in(&bytes);
        let _ = codec::record_in(&bytes[..place]);
        let _ = codec::snapshot_in(&bytes);
    }
}
