//! Repeated ports and interfaces through the C table: described, tied, called by id, changed while the
//! component lives.
#![allow(clippy::unwrap_used)]

mod little_host;

use little_host::LittleHost;
use trocar_plugin_api::abi;
use trocar_sdk::prelude::*;

#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
struct Pose {
    #[unit("m")]
    at: f64,
}

#[derive(Config)]
struct Cfg {
    #[config(default = [], live)]
    arms: Vec<String>,
    #[config(default = [], live)]
    tools: Vec<String>,
}

/// Any number of arms, each with an interface, a robot behind it, an input and an output.
#[derive(Component)]
#[component(model = "none", provides("ctl", "arm_{}"), requires("robot_{}", "clock"))]
struct Arms {
    #[input]
    fixed: In<f64>,
    #[input(name = "{}_q", fifo = 4)]
    q: Many<In<f64>>,
    #[output(name = "{}_at")]
    at: Many<Out<Pose>>,
    #[required(interface = "robot_{}")]
    servo: Many<Function<f64, f64>>,
    #[required(interface = "robot_{}", optional)]
    hold: Many<Function>,
    /// A tool of its own list.
    #[required(name = "grip", interface = "tool_{}")]
    tools: Many<Function<u32>>,
    #[event("ctl")]
    alarm: Event<f64>,
    #[event("arm_{}", unit = "m")]
    reached: Many<Event<f64>>,
    #[names("arm_{}", "robot_{}")]
    arms: Names,
    #[state]
    goal: [f64; 4],
    #[state]
    last: u32,
    #[state]
    sized: u32,
    #[config]
    cfg: Cfg,
    #[host]
    host: Host,
}

#[provides("ctl")]
impl Arms {
    #[command]
    fn rename(&mut self, to: Text<16>) -> Result {
        self.arms.set(to.split(',').filter(|n| !n.is_empty()))?;
        self.host.ports_changed();
        Ok(())
    }
    #[read]
    fn last(s: &ArmsState) -> u32 {
        s.last
    }
}

/// One arm.
#[provides("arm_{}")]
impl Arms {
    #[command]
    fn servo_jp(&mut self, arm: usize, goal: f64) -> Result<f64, String> {
        self.goal[arm] = goal;
        self.reached[arm].emit(goal);
        self.servo[arm].call(goal).map_err(|e| e.to_string())
    }
    #[command]
    fn hold(&mut self, arm: usize) {
        self.last = 10 + arm as u32;
        self.hold[arm].send(());
    }
    #[read]
    fn setpoint_jp(s: &ArmsState, arm: usize) -> f64 {
        s.goal.get(arm).copied().unwrap_or(f64::NAN)
    }
}

#[handles("robot_{}")]
impl Arms {
    #[on]
    fn stopped(&mut self, arm: usize, why: u32) {
        self.last = 100 * (arm as u32 + 1) + why;
    }
}

#[handles("clock")]
impl Arms {
    #[on]
    fn struck(&mut self) {
        self.alarm.emit(7.0);
    }
}

impl Component for Arms {
    fn configure(&mut self) -> Result {
        let arms = self.cfg.arms.clone();
        self.arms.set(&arms)?;
        self.q.set(&arms)?;
        self.at.set(&arms)?;
        self.tools.set(&self.cfg.tools)
    }
    fn ports_changed(&mut self) {
        self.sized = self.arms.len() as u32;
    }
    fn step(&mut self, _: &Tick) -> Result {
        let base = self.fixed.latest().unwrap_or(0.0);
        for (q, at) in self.q.ports_mut().zip(self.at.ports()) {
            if let Some(q) = q.latest() {
                at.write(&Pose { at: base + q });
            }
        }
        for (_, tool) in self.tools.iter() {
            tool.send(1);
        }
        Ok(())
    }
}

fn two_arms() -> Box<LittleHost<Arms>> {
    let mut host = LittleHost::new();
    host.configure(r#"{"arms": ["left", "right"], "tools": ["knife"]}"#).unwrap();
    host.describe_and_bind();
    host
}

#[test]
fn fixed_ports_come_first_and_repeated_ones_by_field_and_name() {
    let host = two_arms();
    let class = &host.description.class;
    let names = |of: Vec<&String>| of.into_iter().cloned().collect::<Vec<_>>();
    assert_eq!(names(class.inputs.iter().map(|p| &p.name).collect()), ["fixed", "left_q", "right_q"]);
    assert_eq!(names(class.outputs.iter().map(|p| &p.name).collect()), ["left_at", "right_at"]);
    assert_eq!(
        names(class.required.iter().map(|r| &r.name).collect()),
        ["clock", "robot_left", "robot_right", "tool_knife"]
    );
    assert_eq!(names(class.provided.iter().map(|p| &p.name).collect()), ["ctl", "arm_left", "arm_right"]);
    assert_eq!(class.inputs[2].fifo, 4);
    let robot = &class.required[2];
    assert_eq!(names(robot.functions.iter().map(|f| &f.name).collect()), ["servo", "hold"]);
    assert_eq!((robot.handlers[0].name.as_str(), robot.functions[1].optional), ("stopped", true));
    assert_eq!(class.required[3].functions[0].name, "grip");
    assert_eq!(
        (class.provided[2].doc.as_str(), class.provided[2].events[0].unit.as_str()),
        ("One arm.", "m")
    );
    assert!(host.description.types.iter().any(|t| t.name == "Pose"), "types of repeated ports are described");
}

#[test]
fn the_manifest_has_the_fixed_ports_only() {
    assert_eq!(Arms::DESC.inputs.len(), 1);
    let host = LittleHost::<Arms>::new();
    assert_eq!(host.description.class.provided.len(), 1);
}

#[test]
fn samples_go_through_each_port_of_its_own() {
    let mut host = two_arms();
    host.inputs[0].value = Some(100.0);
    host.inputs[2].value = Some(2.0);
    host.step().unwrap();
    assert!(host.outputs[0].written.is_empty(), "left has no sample yet");
    assert_eq!(host.outputs[1].written, [102.0]);
}

#[test]
fn commands_reads_events_functions_and_handlers_know_which_one_is_meant() {
    let mut host = two_arms();
    // Ids: rename, last, then servo_jp, hold, setpoint_jp of left and of right.
    assert_eq!(host.command(5, 0.5), Ok(0.5 * 2.0));
    assert_eq!(host.events[2].written, [0.5], "alarm, reached of left, reached of right");
    assert_eq!(host.functions[2].written, [0.5], "servo and hold of left, of right");
    assert_eq!(host.read(7), Ok(0.5));
    assert_eq!(host.read(4), Ok(0.0));
    host.command(6, 0.0).unwrap();
    assert_eq!((host.state().last, host.functions[3].written.len()), (11, 1));
    // Handlers: struck, then stopped of left and of right.
    host.on_event(2, 3).unwrap();
    assert_eq!(host.state().last, 203);
    host.on_event(0, 0).unwrap();
    assert_eq!(host.events[0].written.len(), 1);
    host.step().unwrap();
    assert_eq!(host.functions[4].written.len(), 1, "the knife grips");
}

#[test]
fn ids_beyond_the_list_are_refused() {
    let mut host = two_arms();
    assert_eq!(host.command(8, 0.0).unwrap_err().0, abi::STATUS_UNSUPPORTED);
    assert_eq!(host.on_event(3, 0).unwrap_err().0, abi::STATUS_UNSUPPORTED);
}

#[test]
fn ids_and_ports_keep_their_meaning_until_the_host_has_taken_over_a_new_list() {
    let mut host = two_arms();
    host.rename("right").unwrap();
    assert_eq!(host.asked.ports_changed, 1, "the component asked for a new description");
    host.command(6, 1.0).unwrap();
    assert_eq!(
        (host.state().last, host.functions[3].written.len()),
        (11, 1),
        "hold of right, at its old place"
    );
    assert_eq!(host.state().sized, 2);
    host.describe_and_bind();
    assert_eq!((host.state().sized, host.description.class.provided[1].name.as_str()), (1, "arm_right"));
    assert_eq!(host.command(2, 3.0), Ok(6.0));
    assert_eq!(host.functions[0].written, [3.0]);
    assert_eq!(host.command(5, 0.0).unwrap_err().0, abi::STATUS_UNSUPPORTED);
}

#[test]
fn a_description_without_a_bind_changes_nothing() {
    let mut host = two_arms();
    host.rename("right").unwrap();
    host.describe();
    assert_eq!(host.command(5, 0.5), Ok(1.0));
    assert_eq!(host.functions[2].written, [0.5], "servo of right, at its old place");
}

#[test]
fn names_set_but_not_described_give_no_ports() {
    let mut host = LittleHost::<Arms>::new();
    host.configure(r#"{"arms": ["left"], "tools": ["knife"]}"#).unwrap();
    host.step().unwrap();
    host.bind().unwrap();
    host.step().unwrap();
    assert_eq!(host.command(2, 1.0).unwrap_err().0, abi::STATUS_UNSUPPORTED);
}

#[test]
fn names_that_clash_or_are_none_are_refused_by_configure_with_the_name() {
    let mut host = LittleHost::<Arms>::new();
    let twice = host.configure(r#"{"arms": ["a", "a"]}"#).unwrap_err().1;
    assert!(twice.contains("`a` is given twice"), "{twice}");
    let bad = host.configure(r#"{"arms": ["a b"]}"#).unwrap_err().1;
    assert!(bad.contains("`a b` is no name"), "{bad}");

    /// Two lists whose names meet.
    #[derive(Component)]
    struct Clash {
        #[input]
        fixed: In<f64>,
        #[input]
        more: Many<In<f64>>,
        #[config]
        cfg: Cfg,
    }
    impl Component for Clash {
        fn configure(&mut self) -> Result {
            let _ = self.fixed.latest();
            self.more.set(&self.cfg.arms)
        }
    }
    let mut host = LittleHost::<Clash>::new();
    let clash = host.configure(r#"{"arms": ["fixed"]}"#).unwrap_err().1;
    assert!(clash.contains("`fixed` would be there twice"), "{clash}");
    host.configure(r#"{"arms": ["free"], "tools": []}"#).unwrap();
    host.describe_and_bind();
    assert_eq!(host.inputs.len(), 2);
}

#[test]
fn a_bind_that_does_not_fit_the_description_is_refused() {
    let mut host = two_arms();
    host.inputs.pop();
    let why = host.bind().unwrap_err();
    assert!(why.1.contains("[2, 2, 5, 3]") && why.1.contains("[3, 2, 5, 3]"), "{why:?}");
}

#[test]
fn a_class_whose_ports_are_fixed_has_no_describe() {
    #[derive(Component)]
    struct Plain {}
    impl Component for Plain {}
    let describe = |table: &abi::ClassTable| table.describe.is_some();
    assert!(!describe(trocar_sdk::__private::Export::<Plain>::TABLE));
    assert!(describe(trocar_sdk::__private::Export::<Arms>::TABLE));
}
