//! Requests over gRPC, beside the cheapest request there is.

use std::process::Command;
use std::time::{Duration, Instant};

use tonic::transport::Channel;
use trocar_proto::v1;
use trocar_proto::v1::gcm_service_client::GcmServiceClient;
use trocar_tests::{Built, HostProcess, World};

use crate::table::{Goal, Table, median, timed};

/// Components created, of each of two classes.
const CREATED: usize = 40;
/// Processes of the large system.
const PROCESSES: usize = 50;
/// GetStates that are timed.
const ASKED: usize = 200;

/// A listing is there at once for whoever typed it.
const LISTED: Goal = Goal::Ns(50e6);

/// Requests over one kept connection, beside the cheapest request there is.
pub(crate) fn measure(table: &mut Table) {
    let world = World::new();
    world.drop_in(&Built::plugin("example"));
    let host = HostProcess::start(&world);
    host.grpcurl().await_class("host", "example/Server");
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime can be made");
    let times = runtime.block_on(requests(host.address()));
    table.title("Requests over gRPC (one connection, median)");
    for (what, ns) in ["Create", "Connect", "Start"].iter().zip(times.1) {
        table.row(what, ns, Goal::None, "GetState", times.0);
    }
    table.title(&format!("`trocar ls`, from its start to its end ({} components)", 2 * CREATED));
    let bare = timed(|| run(&["--version"]));
    for args in [&["ls", "--gcm", host.address()][..], &["ls", "--json", "--gcm", host.address()]] {
        let what = format!("`trocar {}`", args[..args.len() - 2].join(" "));
        table.row(&what, timed(|| run(args)), LISTED, "`trocar --version`", bare);
    }
    table.title(&format!("GetState of one component, at a GCM of {PROCESSES} processes (one connection)"));
    let (one, many) = runtime.block_on(states());
    table.row("GetState", many, Goal::Times(2.0), "the same GCM with one process", one);
}

/// The time of a GetState at a GCM of one process, and when there are many, ns.
async fn states() -> (f64, f64) {
    let world = World::new();
    world.drop_in(&Built::plugin("example"));
    let gcm = HostProcess::start_gcm(&world);
    let attached = |name: &str| HostProcess::start_with(&world, name, &["--gcm", gcm.address()]);
    let mut hosts = vec![attached("p1")];
    let grpc = gcm.grpcurl();
    grpc.await_class("p1", "example/Server");
    grpc.create("p1/server", "example/Server", serde_json::json!({}));
    let mut client = client_of(gcm.address()).await;
    let one = state(&mut client).await;
    hosts.extend((2..=PROCESSES).map(|n| attached(&format!("p{n}"))));
    (1..=PROCESSES).for_each(|n| _ = grpc.await_class(&format!("p{n}"), "example/Server"));
    (one, state(&mut client).await)
}

/// The median of many GetStates, ns.
async fn state(client: &mut GcmServiceClient<Channel>) -> f64 {
    let mut took = Vec::new();
    for _ in 0..ASKED {
        let began = Instant::now();
        client.get_state(v1::GetStateRequest { path: "p1/server".into() }).await.expect("GetState");
        took.push(began.elapsed().as_nanos() as f64);
    }
    median(took)
}

/// The program, until it has ended well.
fn run(args: &[&str]) {
    let ended = Command::new(Built::trocar()).args(args).output().expect("the built program can be started");
    assert!(ended.status.success(), "{args:?}: {}", String::from_utf8_lossy(&ended.stderr));
}

async fn client_of(address: &str) -> GcmServiceClient<Channel> {
    let channel = Channel::from_shared(format!("http://{address}"))
        .expect("a host prints a good address")
        .connect_timeout(Duration::from_secs(5))
        .connect()
        .await
        .expect("the host answers");
    GcmServiceClient::new(channel)
}

async fn requests(address: &str) -> (f64, [f64; 3]) {
    let mut gcm = client_of(address).await;
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
