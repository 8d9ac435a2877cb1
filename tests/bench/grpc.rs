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
}

/// The program, until it has ended well.
fn run(args: &[&str]) {
    let ended = Command::new(Built::trocar()).args(args).output().expect("the built program can be started");
    assert!(ended.status.success(), "{args:?}: {}", String::from_utf8_lossy(&ended.stderr));
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
