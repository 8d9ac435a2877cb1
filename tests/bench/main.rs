//! What the spine costs, as ratios measured in one run: `cargo run --release -p trocar-tests --bin bench`.
//!
//! Invariant: every figure stands beside a baseline of the same run on the same machine; nothing here passes or fails.

use std::fmt::Write as _;
use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::json;
use tonic::transport::Channel;
use trocar::loader::{PluginStore, PluginStoreConfig, inspect_file};
use trocar_proto::v1;
use trocar_proto::v1::gcm_service_client::GcmServiceClient;
use trocar_tests::{Built, Grpcurl, HostProcess, World};

/// Calls per measured loop of cheap calls.
const CHEAP: u32 = 2_000_000;
/// Round trips between threads per loop.
const TRIPS: u32 = 20_000;
/// Repetitions of each loop; the median counts.
const RUNS: usize = 7;
/// Components created by gRPC.
const CREATED: usize = 40;

fn main() {
    let mut table = Table::default();
    calls(&mut table);
    loading(&mut table);
    grpc(&mut table);
    print!("{}", table.text);
}

#[derive(Default)]
struct Table {
    text: String,
}

impl Table {
    fn title(&mut self, title: &str) {
        let _ = write!(self.text, "\n### {title}\n\n| what | median | beside | ratio |\n|---|---|---|---|\n");
    }

    /// `ns` beside a baseline in ns.
    fn row(&mut self, what: &str, ns: f64, beside: &str, baseline_ns: f64) {
        let (ns_text, base) = (duration(ns), duration(baseline_ns));
        let _ = writeln!(self.text, "| {what} | {ns_text} | {beside}: {base} | {:.2} |", ns / baseline_ns);
    }
}

fn duration(ns: f64) -> String {
    match ns {
        n if n < 1e3 => format!("{n:.1} ns"),
        n if n < 1e6 => format!("{:.1} µs", n / 1e3),
        n => format!("{:.2} ms", n / 1e6),
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Calls of a component, timed inside it, beside what a call and a wake cost without trocar.
fn calls(table: &mut Table) {
    let world = World::new();
    for plugin in ["fixture_gauge", "fixture_echo"] {
        world.drop_in(&Built::plugin(plugin));
    }
    let host = HostProcess::start(&world);
    let grpcurl = host.grpcurl();
    grpcurl.await_class("host", "fixture-gauge/gauge");
    grpcurl.await_class("host", "fixture-echo/echo");
    grpcurl.create("host/echo", "echo", json!({}));
    grpcurl.create_with("host/inline", "gauge", json!({}), json!({"inside": "host/echo"}));
    grpcurl.create_with("host/caller", "gauge", json!({}), json!({"model": "none"}));
    for client in ["inline", "caller"] {
        grpcurl.connect(&format!("host/{client}/peer"), "host/echo/ctl");
    }
    grpcurl.start("host/**");

    let empty = gauge(&grpcurl, "inline", "nothing", CHEAP);
    let call = closure();
    table.title("Calls from one component to another");
    let mut row = |what: &str, kind: &str| {
        let ns = gauge(&grpcurl, "inline", kind, CHEAP / 4) - empty;
        table.row(what, ns, "a call through a pointer", call);
    };
    row("slot call: write to an output nobody reads", "output");
    row("inline command, sent (write)", "send");
    row("inline command, called (write-return)", "call");
    row("read of the peer's published state", "read");
    let trip = gauge(&grpcurl, "caller", "call", TRIPS);
    table.row(
        "queued round trip to a sleeping component",
        trip,
        "bare ring + futex, there and back",
        ping_pong(),
    );
}

/// Median over the runs of a measuring command, ns per call.
fn gauge(grpcurl: &Grpcurl, component: &str, kind: &str, n: u32) -> f64 {
    let once = || {
        let body = json!({"path": format!("host/{component}/time/{kind}"), "json": n, "deadline": "4s"});
        grpcurl.ok("trocar.v1.InteractService/Invoke", body)["json"].as_f64().unwrap_or(f64::NAN)
    };
    median((0..RUNS).map(|_| once()).collect())
}

/// One call through a function pointer the compiler cannot see through, ns.
fn closure() -> f64 {
    fn add(x: u64) -> u64 {
        black_box(x).wrapping_add(1)
    }
    let run = || {
        let f: fn(u64) -> u64 = black_box(add);
        let began = Instant::now();
        for i in 0..u64::from(CHEAP) {
            black_box(f(black_box(i)));
        }
        began.elapsed().as_nanos() as f64 / f64::from(CHEAP)
    };
    median((0..RUNS).map(|_| run()).collect())
}

/// A word handed to a parked thread and back, ns for both ways: what any queued call has to pay.
fn ping_pong() -> f64 {
    let run = || {
        let (there, back) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
        let stop = Arc::new(AtomicBool::new(false));
        let caller = thread::current();
        let server = {
            let (there, back, stop) = (there.clone(), back.clone(), stop.clone());
            thread::spawn(move || {
                let mut seen = 0;
                while !stop.load(Ordering::Acquire) {
                    let now = there.load(Ordering::Acquire);
                    if now == seen {
                        thread::park();
                        continue;
                    }
                    seen = now;
                    back.store(now, Ordering::Release);
                    caller.unpark();
                }
            })
        };
        let began = Instant::now();
        for i in 1..=u64::from(TRIPS) {
            there.store(i, Ordering::Release);
            server.thread().unpark();
            while back.load(Ordering::Acquire) != i {
                thread::park();
            }
        }
        let ns = began.elapsed().as_nanos() as f64 / f64::from(TRIPS);
        stop.store(true, Ordering::Release);
        server.thread().unpark();
        server.join().expect("the echoing thread does not panic");
        ns
    };
    median((0..RUNS).map(|_| run()).collect())
}

/// From a file in the drop directory to a class that can be created.
fn loading(table: &mut Table) {
    let file = Built::plugin("eyerobot");
    let read = timed(|| {
        black_box(std::fs::read(&file).expect("the plugin is built"));
    });
    table.title("Loading a plugin (libtrocar_eyerobot.so)");
    let inspect = timed(|| {
        black_box(inspect_file(&file).expect("the plugin is good"));
    });
    table.row("read, hashed, judged, listed", inspect, "reading the file", read);
    let world = World::new();
    world.drop_in(&file);
    // A file counts as finished when it has not changed for 200 ms; that wait is not the loader's.
    thread::sleep(Duration::from_millis(300));
    let first = |state: &Path| {
        let dirs = vec![world.plugins()];
        let began = Instant::now();
        let config = PluginStoreConfig::new(dirs, state.to_path_buf(), Built::trocar());
        let store = PluginStore::open(config).expect("the directories are good");
        let class = store.class("eyerobot/eyerobot").expect("the class is listed");
        store.load(&class).expect("the plugin loads");
        began.elapsed().as_nanos() as f64
    };
    let vetted = first(&world.path("state-a"));
    table.row("the whole way the first time, with the vetting child", vetted, "reading the file", read);
    let again = first(&world.path("state-a"));
    table.row("the whole way, vetted before", again, "reading the file", read);
    table.row(
        "dropped into the directory of a running host → class available",
        appears(&file),
        "the wait for a quiet file",
        QUIET_NS,
    );
}

/// Debounce of a watched directory, ns: the least a dropped file can take.
const QUIET_NS: f64 = 100e6;

/// From the copy into the directory to the class in the host's answer, ns.
fn appears(file: &Path) -> f64 {
    let once = || {
        let world = World::new();
        let host = HostProcess::start(&world);
        let grpcurl = host.grpcurl();
        let began = Instant::now();
        world.drop_in(file);
        while grpcurl.classes("host").is_empty() {
            thread::sleep(Duration::from_millis(2));
        }
        began.elapsed().as_nanos() as f64
    };
    median((0..RUNS).map(|_| once()).collect())
}

fn timed(mut f: impl FnMut()) -> f64 {
    let once = |f: &mut dyn FnMut()| {
        let began = Instant::now();
        f();
        began.elapsed().as_nanos() as f64
    };
    median((0..RUNS).map(|_| once(&mut f)).collect())
}

/// Requests over one kept connection, beside the cheapest request there is.
fn grpc(table: &mut Table) {
    let world = World::new();
    world.drop_in(&Built::plugin("example"));
    let host = HostProcess::start(&world);
    host.grpcurl().await_class("host", "example/Server");
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime can be made");
    let times = runtime.block_on(requests(host.address()));
    table.title("Requests over gRPC (one connection, median)");
    for (what, ns) in ["Create", "Connect", "Start"].iter().zip(times.1) {
        table.row(what, ns, "GetState", times.0);
    }
}

async fn requests(address: &str) -> (f64, [f64; 3]) {
    let channel = Channel::from_shared(format!("http://{address}"))
        .expect("a host prints a good address")
        .connect_timeout(Duration::from_secs(5))
        .connect()
        .await
        .expect("the host answers");
    let mut gcm = GcmServiceClient::new(channel);
    let (mut create, mut connect, mut start, mut state) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for i in 0..CREATED {
        let (server, client) = (format!("host/s{i}"), format!("host/c{i}"));
        for (path, class) in [(&server, "Server"), (&client, "Client")] {
            let request = v1::CreateRequest { path: path.clone(), class: class.into(), ..Default::default() };
            let began = Instant::now();
            gcm.create(request).await.expect("Create");
            create.push(began.elapsed().as_nanos() as f64);
        }
        let request = v1::ConnectRequest {
            client: format!("{client}/Required"),
            server: format!("{server}/Provided"),
            ..Default::default()
        };
        let began = Instant::now();
        gcm.connect(request).await.expect("Connect");
        connect.push(began.elapsed().as_nanos() as f64);
        let request = v1::StartRequest { paths: vec![server.clone()], ..Default::default() };
        let began = Instant::now();
        gcm.start(request).await.expect("Start");
        start.push(began.elapsed().as_nanos() as f64);
        let began = Instant::now();
        gcm.get_state(v1::GetStateRequest { path: server }).await.expect("GetState");
        state.push(began.elapsed().as_nanos() as f64);
    }
    (median(state), [median(create), median(connect), median(start)])
}
