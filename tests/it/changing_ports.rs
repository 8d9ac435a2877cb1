//! Ports that change and ports without a type, in a host with linked classes.
//!
//! Promise: what the SDK describes, the host ties; an id never reaches the neighbour; untyped ports need no
//! `unsafe`.

use serde_json::{Value, json};
use tokio::runtime::Runtime;

use trocar_sdk::prelude::*;
use trocar_sdk::{StaticPlugin, static_plugin};
use trocar_tests::eventually;

#[derive(Config)]
struct Cfg {
    /// Names of the arms.
    #[config(default = [], live)]
    arms: Vec<String>,
}

/// Any number of arms, each an interface.
#[derive(Component)]
#[component(model = "none", provides("ctl", "arm_{}"))]
struct Rack {
    #[input(optional)]
    x: In<f64>,
    #[output]
    y: Out<f64>,
    #[output(name = "{}_goal")]
    goals: Many<Out<f64>>,
    #[names]
    arms: Names,
    #[state]
    goal: [f64; 4],
    #[config]
    cfg: Cfg,
    #[host]
    host: trocar_sdk::Host,
}

#[provides("ctl")]
impl Rack {
    #[command]
    fn rename(&mut self, arms: Text<32>) -> Result {
        let arms: Vec<&str> = arms.split(',').collect();
        self.arms.set(&arms)?;
        self.goals.set(&arms)?;
        self.host.ports_changed();
        Ok(())
    }
    #[command]
    fn look(&mut self) -> Result<f64> {
        Ok(self.x.latest().ok_or("nothing was written to x")?)
    }
    #[command]
    fn say(&mut self, value: f64) {
        self.y.write(&value);
    }
}

#[provides("arm_{}")]
impl Rack {
    #[command]
    fn servo(&mut self, arm: usize, #[arg(unit = "rad", max = 3)] goal: f64) -> Result<f64> {
        self.goal[arm] = goal;
        self.goals[arm].write(&goal);
        Ok(goal + 100.0 * arm as f64)
    }
    #[read]
    fn goal(s: &RackState, arm: usize) -> f64 {
        s.goal[arm]
    }
}

impl Component for Rack {
    fn configure(&mut self) -> Result {
        self.arms.set(&self.cfg.arms)?;
        self.goals.set(&self.cfg.arms)
    }
}

/// Talks to whatever is connected.
#[derive(Component)]
#[component(model = "none", provides("ctl"))]
struct Probe {
    #[input(optional)]
    any: AnyIn,
    #[output]
    out: AnyOut,
    #[required(interface = "peer", name = "servo", optional)]
    servo: AnyFunction,
}

#[provides("ctl")]
impl Probe {
    #[command]
    fn ask(&mut self, value: f64) -> Result<f64> {
        let answer = self.servo.call_json(&json!(value))?;
        Ok(answer.as_f64().ok_or("the answer is no number")?)
    }
    #[command]
    fn ask_wrong(&mut self) -> Result<f64> {
        self.servo.call_bytes(&[0; 3])?;
        Ok(0.0)
    }
    #[command]
    fn publish(&mut self, value: f64) -> Result {
        let ty = self.out.ty().ok_or("out is not connected")?;
        let wrong = self.out.write_bytes(&[0; 3], Stamp::INVALID);
        assert_eq!(wrong, Outcome::InvalidArgument);
        let done = self.out.write_bytes(&ty.to_bytes(&json!(value))?, Stamp::INVALID);
        if done.is_ok() { Ok(()) } else { Err(done.to_string().into()) }
    }
    #[command]
    fn see(&mut self) -> Result<f64> {
        let ty = self.any.ty().ok_or("any is not connected")?;
        let view = self.any.latest().ok_or("nothing there")?;
        let place = ty.place("").ok_or("no number")?;
        Ok(place.number(view.value()).ok_or("too few bytes")?)
    }
}

impl Component for Probe {}

#[derive(Config)]
struct Cameras {
    /// Names of the cameras.
    #[config(default = [])]
    cameras: Vec<String>,
}

/// Any number of cameras, each with frames of a gigabyte.
#[derive(Component)]
#[component(model = "none")]
struct Wall {
    #[output(name = "{}_video", format = "gray8", max_bytes = 1_073_741_824)]
    videos: Many<Out<Frame<Stamp>>>,
    #[config]
    cfg: Cameras,
}

impl Component for Wall {
    fn configure(&mut self) -> Result {
        self.videos.set(&self.cfg.cameras)
    }
}

const PLUGIN: StaticPlugin = static_plugin!(name = "changing", Rack, Probe, Wall);

struct Lab {
    runtime: Runtime,
    host: trocar::Host,
}

impl Lab {
    fn new() -> Lab {
        let runtime = Runtime::new().unwrap();
        let host = runtime.block_on(trocar::Host::builder().name("lab").plugin(PLUGIN).start()).unwrap();
        let lab = Lab { runtime, host };
        let config = json!({"arms": ["left", "right"]});
        lab.runtime.block_on(lab.host.create("lab/rack", "rack", config)).unwrap();
        lab.runtime.block_on(lab.host.start("lab/rack")).unwrap();
        lab
    }

    fn probe(&self) {
        self.runtime.block_on(self.host.create("lab/probe", "probe", json!({}))).unwrap();
        self.runtime.block_on(self.host.start("lab/probe")).unwrap();
    }

    fn connect(&self, client: &str, server: &str) {
        self.runtime.block_on(self.host.connect(client, server)).unwrap();
    }

    fn invoke(&self, path: &str, arg: Value) -> Result<Value, String> {
        let reply = self.runtime.block_on(self.host.invoke(path, arg)).map_err(|e| e.to_string())?;
        Ok(reply.value.unwrap_or_default())
    }
}

#[test]
fn a_list_in_the_configuration_makes_interfaces_that_answer_each_for_itself() {
    let lab = Lab::new();
    assert_eq!(lab.invoke("lab/rack/arm_right/servo", json!(2.5)), Ok(json!(102.5)));
    assert_eq!(lab.invoke("lab/rack/arm_left/servo", json!(1.5)), Ok(json!(1.5)));
    assert_eq!(lab.invoke("lab/rack/arm_right/goal", Value::Null), Ok(json!(2.5)));
    let limits = lab.invoke("lab/rack/arm_right/servo", json!(4.0)).unwrap_err();
    assert!(limits.contains("rad"), "{limits}");
    let missing = lab.invoke("lab/rack/arm_middle/servo", json!(1.0)).unwrap_err();
    assert!(missing.contains("arm_left"), "lists what exists: {missing}");
    lab.probe();
    lab.connect("lab/probe/any", "lab/rack/right_goal");
    lab.invoke("lab/rack/arm_left/servo", json!(1.0)).unwrap();
    assert!(lab.invoke("lab/probe/ctl/see", Value::Null).is_err(), "left writes to its own output");
    lab.invoke("lab/rack/arm_right/servo", json!(2.0)).unwrap();
    assert_eq!(lab.invoke("lab/probe/ctl/see", Value::Null), Ok(json!(2.0)));
}

#[test]
fn a_list_that_changes_while_the_component_lives_moves_no_command_to_a_neighbour() {
    let lab = Lab::new();
    assert_eq!(lab.invoke("lab/rack/ctl/rename", json!("right,new")), Ok(Value::Null));
    eventually("the new interface", || lab.invoke("lab/rack/arm_new/servo", json!(0.5)));
    assert_eq!(lab.invoke("lab/rack/arm_right/servo", json!(2.0)), Ok(json!(2.0)), "right is the first now");
    let gone = lab.invoke("lab/rack/arm_left/servo", json!(1.0)).unwrap_err();
    assert!(gone.contains("arm_right"), "{gone}");
}

#[test]
fn a_live_configuration_changes_the_ports_too() {
    let lab = Lab::new();
    let config = json!({"arms": ["only"]});
    lab.runtime.block_on(lab.host.configure("lab/rack", config)).unwrap();
    eventually("the new interface", || lab.invoke("lab/rack/arm_only/servo", json!(0.5)));
    let clash = json!({"arms": ["a", "a"]});
    let refused = lab.runtime.block_on(lab.host.configure("lab/rack", clash)).unwrap_err().to_string();
    assert!(refused.contains("`a` is given twice"), "{refused}");
    assert_eq!(lab.invoke("lab/rack/arm_only/servo", json!(1.0)), Ok(json!(1.0)), "the old ports stay");
}

#[test]
fn untyped_ports_take_the_type_of_what_they_are_connected_to() {
    let lab = Lab::new();
    lab.probe();
    let unbound = lab.invoke("lab/probe/ctl/ask", json!(1.0)).unwrap_err();
    assert!(unbound.contains("no peer is connected"), "{unbound}");

    lab.connect("lab/probe/peer", "lab/rack/arm_right");
    lab.connect("lab/rack/x", "lab/probe/out");
    lab.connect("lab/probe/any", "lab/rack/y");
    assert_eq!(lab.invoke("lab/probe/ctl/ask", json!(2.0)), Ok(json!(102.0)));
    let wrong = lab.invoke("lab/probe/ctl/ask_wrong", Value::Null).unwrap_err();
    assert!(wrong.contains("argument"), "{wrong}");
    let limits = lab.invoke("lab/probe/ctl/ask", json!(9.0)).unwrap_err();
    assert!(limits.contains("outside its limits"), "{limits}");
    lab.invoke("lab/probe/ctl/publish", json!(7.5)).unwrap();
    assert_eq!(lab.invoke("lab/rack/ctl/look", Value::Null), Ok(json!(7.5)));
    lab.invoke("lab/rack/ctl/say", json!(-4.0)).unwrap();
    assert_eq!(lab.invoke("lab/probe/ctl/see", Value::Null), Ok(json!(-4.0)));
}

#[test]
fn a_configuration_that_needs_more_frames_than_there_is_memory_for_is_refused_with_how_much_that_is() {
    let lab = Lab::new();
    let cameras: Vec<String> = (0..2000).map(|n| format!("c{n}")).collect();
    let create = |cameras: &[String]| {
        lab.runtime.block_on(lab.host.create("lab/wall", "wall", json!({"cameras": cameras})))
    };
    let refused = create(&cameras).expect_err("no machine has that much").to_string();
    for said in ["lab/wall", "c0_video", "17179", "bytes of memory are available"] {
        assert!(refused.contains(said), "{said}: {refused}");
    }
    create(&[]).map(|_| ()).unwrap();
}
