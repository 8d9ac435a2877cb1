//! Places in their periods at which the components of one grid step: each reader behind what feeds it.

use std::collections::BTreeMap;
use std::sync::Arc;

use proptest::prelude::*;
use serde_json::json;
use trocar_model::*;

use crate::scene::*;

const MS: u64 = 1_000_000;

/// Components `host/c0` to `host/c7` of 1 kHz, each with an output and eight inputs.
#[derive(Default)]
struct Ring {
    graph: SystemGraph,
    steps: StepTimes,
}

impl Ring {
    fn of(count: usize) -> Ring {
        let mut ring = Ring::default();
        (0..count).for_each(|n| ring.add(&n.to_string(), None));
        ring
    }

    fn add(&mut self, name: &str, phase_ns: Option<u64>) {
        let sample = || PortType::Plain(force("N"));
        let ports = Ports {
            inputs: (0..8).map(|n| input(&format!("in_{n}"), sample())).collect(),
            outputs: vec![output("out", sample())],
            ..Ports::default()
        };
        let class = Arc::new(class("test", "cell", ExecutionModel::Periodic, ports));
        let component = Component {
            config: json!({}),
            execution: Execution { phase_ns, ..class.execution.clone() },
            ports: Arc::new(class.ports.clone()),
            state: State::Ready,
            health: Health::Ok,
            fault: String::new(),
            class,
        };
        self.graph.components.insert(id(&format!("host/c{name}")), component);
    }

    fn connect(&mut self, from: usize, to: usize) -> &mut ConnectOptions {
        let number = ConnectionId(self.graph.connections.len() as u64 + 1);
        let (client, server) = (port(&format!("host/c{to}/in_{from}")), port(&format!("host/c{from}/out")));
        let connection = Connection { id: number, client, server, options: ConnectOptions::default() };
        self.graph.connections.insert(number, connection);
        &mut self.graph.connections.get_mut(&number).unwrap().options
    }

    fn execution(&mut self, name: usize) -> &mut Execution {
        &mut self.graph.components.get_mut(&id(&format!("host/c{name}"))).unwrap().execution
    }

    fn phases(&self) -> BTreeMap<ComponentId, Phase> {
        phases(&self.graph, &self.steps)
    }

    fn us(&self) -> Vec<u64> {
        self.phases().values().map(|phase| phase.phase_ns / 1_000).collect()
    }

    fn notes(&self) -> String {
        self.phases().into_values().map(|phase| phase.note).collect()
    }
}

#[test]
fn a_chain_steps_along_its_samples_whoever_was_made_first() {
    let mut ring = Ring::of(3);
    assert_eq!(ring.us(), [0, 0, 0], "alone each begins with its period");
    ring.connect(2, 0);
    ring.connect(0, 1);
    // An eighth of the period for an unmeasured step, and three sixteenths for threads that are late.
    assert_eq!(ring.us(), [312, 625, 0]);
    assert_eq!(ring.notes(), "");
}

#[test]
fn a_reader_waits_for_the_step_of_what_feeds_it_and_for_those_that_run_inside_it() {
    let mut ring = Ring::of(2);
    ring.connect(0, 1);
    ring.steps.insert(id("host/c0"), 90_000);
    assert_eq!(ring.us(), [0, 500], "less than was kept for it: in the middle");
    ring.steps.insert(id("host/c0"), 200_000);
    assert_eq!(ring.us(), [0, 625]);
    ring.add("2", None);
    let inside = ring.execution(2);
    (inside.model, inside.inside, inside.period_ns) =
        (Some(ExecutionModel::ExecIn), Some("host/c0".into()), None);
    ring.steps.insert(id("host/c2"), 150_000);
    assert_eq!(ring.us(), [0, 687], "350 µs together: half a period is kept");
}

#[test]
fn a_phase_that_was_asked_for_is_kept_and_others_go_by_it() {
    let mut ring = Ring::of(2);
    ring.connect(0, 1);
    ring.execution(0).phase_ns = Some(600_000);
    assert_eq!(ring.us(), [100], "the reader, behind it");
    assert_eq!(ring.notes(), "", "it is half a period behind, in the next one");
    ring.execution(0).phase_ns = None;
    ring.execution(1).phase_ns = Some(0);
    // The writer steps first, and is read at the end of its period: at 0 its sample would come too late.
    assert_eq!(ring.us(), [375]);
    ring.execution(0).phase_ns = Some(0);
    assert!(ring.phases().is_empty(), "nothing is left to choose");
}

#[test]
fn a_circle_is_cut_where_its_connection_says_delay_else_at_the_newest_one() {
    let mut ring = Ring::of(2);
    ring.connect(0, 1);
    ring.connect(1, 0);
    assert_eq!(ring.us(), [0, 500]);
    ring.graph.connections.get_mut(&ConnectionId(1)).unwrap().options.delay = true;
    assert_eq!(ring.us(), [500, 0]);
    assert_eq!(ring.notes(), "", "either way all samples arrive");
}

#[test]
fn steps_that_together_take_longer_than_the_period_go_on_in_the_next_one_and_say_so() {
    let mut ring = Ring::of(3);
    ring.connect(0, 1);
    ring.connect(1, 2);
    ring.steps.extend([(id("host/c0"), 500_000), (id("host/c1"), 500_000)]);
    assert_eq!(ring.us(), [0, 687, 375]);
    assert!(ring.notes().contains("takes samples one period later"), "{}", ring.notes());
    assert!(!ring.notes().contains("left out"), "{}", ring.notes());
}

#[test]
fn a_step_as_long_as_the_period_has_no_room_and_says_so() {
    let mut ring = Ring::of(2);
    ring.connect(0, 1);
    ring.steps.insert(id("host/c0"), 2 * MS);
    assert!(ring.notes().contains("samples between them may be left out"), "{}", ring.notes());
}

#[test]
fn other_rates_and_models_have_grids_of_their_own() {
    let mut ring = Ring::of(4);
    (0..3).for_each(|n| _ = ring.connect(n, n + 1));
    ring.execution(1).period_ns = Some(2 * MS);
    let free = ring.execution(3);
    (free.model, free.period_ns) = (Some(ExecutionModel::Continuous), None);
    assert_eq!(ring.us(), [0, 0, 0], "no two of one period are connected");
}

#[test]
fn a_slow_grid_waits_no_longer_than_threads_are_late() {
    let mut ring = Ring::of(2);
    ring.connect(0, 1);
    (0..2).for_each(|n| ring.execution(n).period_ns = Some(100 * MS));
    assert_eq!(ring.us(), [0, 1_500]);
}

/// Edges (from, to), explicit phases and step times of eight components, ns.
type Drawn = (Vec<(usize, usize, bool)>, Vec<Option<u64>>, Vec<Option<u64>>);

fn any_ring() -> impl Strategy<Value = Drawn> {
    let edges = prop::collection::vec((0..8_usize, 0..8_usize, prop::bool::weighted(0.1)), 0..14);
    let phase = prop::option::weighted(0.15, 0..MS);
    let step = prop::option::weighted(0.5, 0..300_000_u64);
    (edges, prop::collection::vec(phase, 8), prop::collection::vec(step, 8))
}

fn drawn((edges, fixed, steps): &Drawn) -> Ring {
    let mut ring = Ring::of(0);
    fixed.iter().enumerate().for_each(|(n, phase)| ring.add(&n.to_string(), *phase));
    for (from, to, delay) in edges {
        ring.connect(*from, *to).delay = *delay;
    }
    let steps = steps.iter().enumerate().filter_map(|(n, ns)| Some((id(&format!("host/c{n}")), (*ns)?)));
    ring.steps = steps.collect();
    ring
}

proptest! {
    #[test]
    fn each_reader_steps_behind_what_feeds_it_and_before_its_next_step_unless_it_says_so(drawing in any_ring()) {
        let ring = drawn(&drawing);
        let given = ring.phases();
        let (_, fixed, steps) = &drawing;
        for (n, phase) in fixed.iter().enumerate() {
            prop_assert_eq!(given.contains_key(&id(&format!("host/c{n}"))), phase.is_none());
        }
        let at = |n: usize| fixed[n].unwrap_or_else(|| given[&id(&format!("host/c{n}"))].phase_ns);
        let short = |n: usize| given.get(&id(&format!("host/c{n}"))).is_some_and(|p| p.note.contains("left out"));
        for (from, to, _) in drawing.0.iter().filter(|(from, to, _)| from != to) {
            let asked = fixed[*from].is_some() && fixed[*to].is_some();
            if asked || short(*from) || short(*to) {
                continue;
            }
            let behind = (at(*to) + MS - at(*from)) % MS;
            let (step, margin) = (steps[*from].unwrap_or(0), MS / 32);
            prop_assert!(behind >= step + margin && behind + margin <= MS, "{}→{}: {} behind", from, to, behind);
        }
    }

    /// A tree has room for all, whatever its depth, as long as each period has room for a step and two
    /// margins.
    #[test]
    fn where_nobody_reads_two_that_feed_each_other_all_samples_arrive(
        feeders in prop::collection::vec(any::<prop::sample::Index>(), 7),
        steps in prop::collection::vec(0..250_000_u64, 8),
    ) {
        let mut ring = Ring::of(8);
        for (n, feeder) in feeders.iter().enumerate() {
            ring.connect(feeder.index(n + 1), n + 1);
        }
        ring.steps = steps.iter().enumerate().map(|(n, ns)| (id(&format!("host/c{n}")), *ns)).collect();
        prop_assert!(!ring.notes().contains("left out"), "{}", ring.notes());
    }
}
