//! Repeated provided interfaces that share one list of names: each has commands, reads and events of its own.
#![allow(clippy::unwrap_used)]

mod little_host;

use little_host::LittleHost;
use trocar_sdk::prelude::*;

#[derive(Config)]
struct Cfg {
    #[config(default = [], live)]
    arms: Vec<String>,
}

/// Any number of arms, each with what it measures in its base and in its tip, and tools of another list.
#[derive(Component)]
#[component(model = "none", provides("ctl", "arm_{}", "tool_{}", "arm_{}_tip"))]
struct Arms {
    #[event("arm_{}")]
    moved: Many<Event<f64>>,
    #[event("arm_{}_tip")]
    touched: Many<Event<f64>>,
    #[event("arm_{}_tip")]
    left: Many<Event<f64>>,
    #[names("arm_{}", "arm_{}_tip")]
    arms: Names,
    #[names("tool_{}")]
    tools: Names,
    #[state]
    at: [f64; 4],
    #[config]
    cfg: Cfg,
}

#[provides("ctl")]
impl Arms {
    #[read]
    fn first(s: &ArmsState) -> f64 {
        s.at[0]
    }
}

#[provides("arm_{}")]
impl Arms {
    #[command]
    fn go(&mut self, arm: usize, to: f64) -> f64 {
        self.at[arm] = to;
        self.moved[arm].emit(to);
        to + 100.0 * arm as f64
    }
    #[read]
    fn at(s: &ArmsState, arm: usize) -> f64 {
        s.at[arm]
    }
}

#[provides("arm_{}_tip")]
impl Arms {
    #[read]
    fn depth(s: &ArmsState, arm: usize) -> f64 {
        -s.at[arm]
    }
    #[command]
    fn touch(&mut self, arm: usize, to: f64) -> f64 {
        self.touched[arm].emit(to);
        self.left[arm].emit(-to);
        to + 1000.0 * arm as f64
    }
}

#[provides("tool_{}")]
impl Arms {
    #[command]
    fn grip(&mut self, tool: usize, force: f64) -> f64 {
        force + 10.0 * tool as f64
    }
}

impl Component for Arms {
    fn configure(&mut self) -> Result {
        self.arms.set(&self.cfg.arms)?;
        self.tools.set(["t"])
    }
}

fn arms(names: &str) -> Box<LittleHost<Arms>> {
    let mut host = LittleHost::<Arms>::new();
    host.configure(names).unwrap();
    host.describe_and_bind();
    host
}

#[test]
fn interfaces_of_one_list_are_described_name_by_name_before_those_of_another() {
    let host = arms(r#"{"arms": ["a", "b"]}"#);
    let names: Vec<&str> = host.description.class.provided.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(names, ["ctl", "arm_a", "arm_a_tip", "arm_b", "arm_b_tip", "tool_t"]);
}

#[test]
fn commands_reads_and_events_reach_the_arm_and_the_interface_that_are_meant() {
    let mut host = arms(r#"{"arms": ["a", "b"]}"#);
    // first; go, at, depth, touch of a; the same of b; grip of the tool.
    assert_eq!((host.command(1, 0.25), host.command(5, 0.5)), (Ok(0.25), Ok(100.5)));
    assert_eq!((host.read(0), host.read(2), host.read(3)), (Ok(0.25), Ok(0.25), Ok(-0.25)));
    assert_eq!((host.read(6), host.read(7)), (Ok(0.5), Ok(-0.5)));
    assert_eq!((host.command(4, 2.0), host.command(8, 3.0)), (Ok(2.0), Ok(1003.0)));
    assert_eq!(host.command(9, 1.0), Ok(1.0), "the tool");
    let written: Vec<&[f64]> = host.events.iter().map(|e| e.written.as_slice()).collect();
    assert_eq!(written, [&[0.25][..], &[2.0], &[-2.0], &[0.5], &[3.0], &[-3.0]]);
    assert!(host.command(10, 0.0).is_err(), "no second tool");
    assert!(host.read(1).is_err() && host.command(2, 0.0).is_err(), "neither is the other");
}

#[test]
fn other_names_move_the_ids_and_nothing_is_mixed_up() {
    let mut host = arms(r#"{"arms": ["a", "b", "c"]}"#);
    assert_eq!(host.command(9, 0.75), Ok(200.75), "the third arm");
    host.configure(r#"{"arms": ["c"]}"#).unwrap();
    host.describe_and_bind();
    assert_eq!((host.command(1, 0.5), host.command(5, 0.5)), (Ok(0.5), Ok(0.5)), "one arm, then the tool");
    assert_eq!((host.read(2), host.read(3)), (Ok(0.5), Ok(-0.5)));
    host.configure(r#"{"arms": []}"#).unwrap();
    host.describe_and_bind();
    assert_eq!(host.command(1, 0.5), Ok(0.5), "only the tool");
}
