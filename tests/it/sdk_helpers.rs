//! Slices of a frame and services as an SDK author uses them, in a real host.
//!
//! Promise: `execution.threads` is all a filter needs to work on several threads, and a component builds a
//! system.

use std::collections::BTreeSet;
use std::sync::Mutex;
use std::thread;

use serde_json::{Value, json};
use tokio::runtime::Runtime;
use trocar::model::Execution;
use trocar_sdk::prelude::*;
use trocar_sdk::{ServiceReply, StaticPlugin, static_plugin};
use trocar_tests::eventually;

/// Adds up rows on the threads of its stream.
#[derive(Component)]
#[component(model = "stream", rate_hz = 200, provides("ctl"))]
struct Slicer {
    #[host]
    host: trocar_sdk::Host,
    #[state]
    wrong: u64,
    #[state]
    threads: u64,
    #[state]
    seen: u64,
    #[state]
    told: u64,
}

#[provides("ctl")]
impl Slicer {
    /// Wrong sums, threads there are, most threads that worked at once on one step, panics that were told.
    #[read]
    fn result(s: &SlicerState) -> [u64; 4] {
        [s.wrong, s.threads, s.seen, s.told]
    }
}

impl Component for Slicer {
    fn step(&mut self, _: &Tick) -> Result {
        let seen = Mutex::new(BTreeSet::new());
        let mut pixels = vec![1u32; 640 * 99];
        self.host.par_rows(&mut pixels, 640, |rows, part| {
            seen.lock().unwrap().insert(format!("{:?}", thread::current().id()));
            for (row, pixels) in rows.zip(part.chunks_mut(640)) {
                pixels.iter_mut().for_each(|p| *p += row as u32);
            }
        })?;
        let right = pixels.iter().enumerate().all(|(i, p)| *p == 1 + (i / 640) as u32);
        self.wrong += u64::from(!right);
        self.threads = self.host.threads() as u64;
        self.seen = self.seen.max(seen.into_inner().unwrap().len() as u64);
        let told = self.host.parallel(5, |slice| assert!(slice != 3, "not this one"));
        self.told += u64::from(told.is_err_and(|e| e.to_string().contains("slice 3")));
        Ok(())
    }
}

/// Makes a slicer and starts it; asks for a class that is not there.
#[derive(Component)]
#[component(model = "none", provides("ctl"))]
struct Asker {
    #[host]
    host: trocar_sdk::Host,
    #[state]
    made: u64,
    #[state]
    refused: u64,
    making: u64,
}

#[provides("ctl")]
impl Asker {
    #[command]
    fn build(&mut self) -> Result {
        let ask = self.host.services();
        self.making = ask.create("lab/made", "slicer", Value::Null).map_err(|o| o.to_string())?;
        ask.create("lab/never", "no_such_class", json!({})).map_err(|o| o.to_string())?;
        Ok(())
    }
    #[read]
    fn replies(s: &AskerState) -> [u64; 2] {
        [s.made, s.refused]
    }
}

impl Component for Asker {
    fn answered(&mut self, reply: ServiceReply) -> Result {
        if reply.token == self.making && reply.ok {
            self.made += 1;
            self.host.services().start("lab/made").map_err(|o| o.to_string())?;
        }
        self.refused +=
            u64::from(reply.reason == "CLASS_NOT_FOUND" && reply.message.contains("no_such_class"));
        Ok(())
    }
}

const PLUGIN: StaticPlugin = static_plugin!(name = "helpers", Slicer, Asker);

fn host(runtime: &Runtime) -> trocar::Host {
    runtime.block_on(trocar::Host::builder().name("lab").plugin(PLUGIN).start()).unwrap()
}

fn numbers(runtime: &Runtime, host: &trocar::Host, path: &str) -> Vec<u64> {
    let reply = runtime.block_on(host.invoke(path, Value::Null)).unwrap();
    serde_json::from_value(reply.value.unwrap()).unwrap()
}

#[test]
fn a_filter_works_on_as_many_threads_as_its_stream_is_given() {
    let runtime = Runtime::new().unwrap();
    let host = host(&runtime);
    for (path, threads) in [("lab/alone", None), ("lab/three", Some(3))] {
        let execution = Execution { threads, ..Execution::default() };
        runtime.block_on(host.create_with(path, "slicer", json!({}), execution)).unwrap();
        runtime.block_on(host.start(path)).unwrap();
        let want = u64::from(threads.unwrap_or(1));
        let result = eventually("slices on all threads and a panic that was told", || {
            let now = numbers(&runtime, &host, &format!("{path}/ctl/result"));
            if now[2] >= want.min(2) && now[3] > 0 { Ok(now) } else { Err(format!("{now:?}")) }
        });
        assert_eq!((result[0], result[1]), (0, want), "wrong sums, threads");
        assert!(result[2] <= want, "{result:?}");
    }
}

#[test]
fn a_component_makes_another_one_and_is_told_what_was_refused() {
    let runtime = Runtime::new().unwrap();
    let host = host(&runtime);
    runtime.block_on(host.create("lab/asker", "asker", json!({}))).unwrap();
    runtime.block_on(host.start("lab/asker")).unwrap();
    runtime.block_on(host.invoke("lab/asker/ctl/build", Value::Null)).unwrap();
    eventually("both replies", || match numbers(&runtime, &host, "lab/asker/ctl/replies").as_slice() {
        [1, 1] => Ok(()),
        other => Err(format!("{other:?}")),
    });
    eventually("the component it made runs", || {
        let now = runtime.block_on(host.invoke("lab/made/ctl/result", Value::Null));
        now.map_err(|e| e.to_string()).and_then(|r| r.value.ok_or("no value yet".to_string()))
    });
}
