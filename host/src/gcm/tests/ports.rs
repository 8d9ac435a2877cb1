//! Ports that change by themselves: the connections that go with them, and the thread a component is given
//! later.

use trocar_lcm_api::{News, Report};
use trocar_model::{ConnectOptions, ConnectionId, PortId, PortType, Ports, Prim, Type, Which};

use super::*;

fn connect(client: &str, server: &str) -> Request {
    Request::Connect {
        client: PortId::parse(client).unwrap(),
        server: PortId::parse(server).unwrap(),
        options: ConnectOptions::default(),
    }
}

/// b uses a's arm (connection 1) and a's value (connection 2); revision 1.
async fn wired() -> (Gcm, Arc<FakeLcm>) {
    let (gcm, lcm) = system().await;
    let wires = [connect("host/b/robot", "host/a/arm"), connect("host/b/input", "host/a/value")];
    let all = [create("host/a"), create("host/b")].into_iter().chain(wires).collect();
    ask(&gcm, all).await.unwrap();
    (gcm, lcm)
}

/// Returns the report of `path` when its ports are others.
fn report(gcm: &Gcm, path: &str, lost: &[u64], change: impl FnOnce(&mut Ports)) -> Report {
    let component = component(&gcm.graph(), path);
    let mut ports = (*component.ports).clone();
    change(&mut ports);
    Report {
        id: id(path),
        number: 0,
        state: component.state,
        health: Health::Ok,
        fault: String::new(),
        ports: Some(Arc::new(ports)),
        lost_connections: lost.to_vec(),
        warnings: Vec::new(),
    }
}

fn numbers(graph: &SystemGraph) -> Vec<u64> {
    graph.connections.keys().map(|id| id.0).collect()
}

#[tokio::test]
async fn a_port_that_goes_takes_its_connections_with_it_as_a_new_revision() {
    let (gcm, lcm) = wired().await;
    lcm.news.send(News::State(report(&gcm, "host/a", &[1], |p| p.provided.clear()))).unwrap();
    let graph = until(&gcm, "the connection goes", |g| numbers(g) == [2]).await;
    assert_eq!(graph.revision, 2, "whoever planned for revision 1 must plan anew");
    assert!(graph.components[&id("host/a")].ports.provided.is_empty());
    let refusal = ask(&gcm, vec![connect("host/b/robot", "host/a/arm")]).await.unwrap_err();
    assert_eq!(refusal.reason(), "INTERFACE_NOT_FOUND");
}

#[tokio::test]
async fn a_connection_that_does_not_fit_any_more_is_cut_in_the_process_too() {
    let (gcm, lcm) = wired().await;
    let cut = "Disconnect host/b/input from host/a/value";
    lcm.hold(cut);
    let other = |p: &mut Ports| p.outputs[0].ty = PortType::Plain(Type::Prim(Prim::Bool));
    lcm.news.send(News::State(report(&gcm, "host/a", &[], other))).unwrap();
    until(&gcm, "the connection goes", |g| numbers(g) == [1]).await;
    comes("the process is told", lcm.hangs(cut)).await;
    lcm.release(cut);
}

#[tokio::test]
async fn a_report_takes_nobody_elses_connection() {
    let (gcm, lcm) = wired().await;
    ask(&gcm, vec![create("host/c")]).await.unwrap();
    lcm.news.send(News::State(report(&gcm, "host/c", &[1, 2, 99], |p| p.provided.clear()))).unwrap();
    let graph = until(&gcm, "the report", |g| g.components[&id("host/c")].ports.provided.is_empty()).await;
    assert_eq!((numbers(&graph), graph.revision), (vec![1, 2], 2));
}

#[tokio::test]
async fn ports_that_are_the_same_change_nothing() {
    let (gcm, lcm) = wired().await;
    let same = Report { fault: "seen".into(), ..report(&gcm, "host/a", &[], |_| {}) };
    lcm.news.send(News::State(same)).unwrap();
    let graph = until(&gcm, "the report", |g| g.components[&id("host/a")].fault == "seen").await;
    assert_eq!((numbers(&graph), graph.revision), (vec![1, 2], 1));
}

#[tokio::test]
async fn a_process_that_comes_back_with_other_ports_loses_what_does_not_fit() {
    let (gcm, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("host"));
    let who = host();
    let registered = register(&gcm, who.clone(), lcm.clone()).await.unwrap();
    let all = vec![create("host/a"), create("host/b"), connect("host/b/robot", "host/a/arm")];
    ask(&gcm, all).await.unwrap();
    let mut inventory = lcm.inventory().await.unwrap();
    let changed = report(&gcm, "host/a", &[], |p| p.provided.clear());
    inventory.components.retain(|r| r.id != changed.id);
    inventory.components.push(changed);
    gcm.lost(&name("host"), registered.epoch);
    gcm.register(who, lcm, inventory).await.unwrap();
    assert_eq!(numbers(&gcm.graph()), Vec::<u64>::new());
}

/// Creates `path`, which has an input `made` once it is configured.
fn maker(lcm: &FakeLcm, path: &str) -> Request {
    let mut ports = crate::gcm::fake::class().ports.clone();
    let input = ports.inputs[0].clone();
    ports.inputs.push(trocar_model::Input { name: "made".into(), ..input });
    lcm.ports_at(&format!("Configure {path}"), ports);
    let config = Some(serde_json::json!({ "gain": 2.0 }));
    Request::Create { id: id(path), class: "arm".into(), config, execution: Execution::default() }
}

/// Creates a source and a component that has an input `made` once it is configured, and connects that.
fn with_a_made_port(lcm: &FakeLcm) -> Vec<Request> {
    let made = maker(lcm, "host/b");
    vec![create("host/a"), made, connect("host/b/made", "host/a/value"), start("host/**")]
}

#[tokio::test]
async fn any_number_of_components_make_ports_in_one_request() {
    let (gcm, lcm) = system().await;
    let (b, c) = (maker(&lcm, "host/b"), maker(&lcm, "host/c"));
    let wires = ["host/b", "host/c"].map(|path| connect(&format!("{path}/made"), "host/a/value"));
    let [to_b, to_c] = wires;
    let done = ask(&gcm, vec![create("host/a"), b, to_b, c, to_c, start("host/**")]).await.unwrap();
    assert_eq!((numbers(&gcm.graph()), done.revision), (vec![1, 2], 1), "one request is one change");
    assert_eq!(component(&gcm.graph(), "host/c").state, State::Active);
}

#[tokio::test]
async fn ports_that_a_configuration_makes_are_connected_beside_its_create() {
    let (gcm, lcm) = system().await;
    let all = with_a_made_port(&lcm);
    let done = ask(&gcm, all).await.unwrap();
    assert_eq!((numbers(&gcm.graph()), done.revision), (vec![1], 1), "one request is one change");
    assert_eq!(component(&gcm.graph(), "host/b").state, State::Active);
    let lines = plan_lines(&done.plan).join("; ");
    assert!(lines.contains("create host/b") && lines.contains("host/b/made"), "{lines}");
}

#[tokio::test]
async fn what_was_made_to_find_out_its_ports_goes_when_the_others_are_refused() {
    let (gcm, lcm) = system().await;
    let mut all = with_a_made_port(&lcm);
    all.insert(3, connect("host/b/mode", "host/a/value"));
    let refusal = ask(&gcm, all.clone()).await.unwrap_err();
    assert!(refusal.to_string().contains("made"), "it lists what there is: {refusal}");
    let gone = |lcm: &FakeLcm| (lcm.state("host/a"), lcm.state("host/b")) == (None, None);
    assert!(gcm.graph().components.is_empty() && gone(&lcm), "{:?}", lcm.done());
    all.remove(3);
    lcm.refuse("Start host/b");
    assert_eq!(ask(&gcm, all).await.unwrap_err().reason(), "COMPONENT_REFUSED");
    assert!(gcm.graph().components.is_empty() && gone(&lcm), "{:?}", lcm.done());
    assert_eq!(
        (gcm.graph().connections.len(), gcm.graph().revision),
        (0, 0),
        "a refused request is no change"
    );
}

#[tokio::test]
async fn a_later_part_that_meets_another_request_is_told_so_and_all_of_it_is_taken_back() {
    let (gcm, lcm) = system().await;
    let there = ["host/a", "host/c", "host/d"].map(create).into_iter();
    ask(&gcm, there.chain([connect("host/d/input", "host/c/value")]).collect()).await.unwrap();
    let before = gcm.graph();
    lcm.hold("Start host/d");
    let other = gcm.clone();
    let starting = tokio::spawn(async move { ask(&other, vec![start("host/d")]).await });
    comes("d is being started", lcm.hangs("Start host/d")).await;
    // Only the plan of the Remove shows that it takes something from d.
    let remove = Request::Remove { id: id("host/c"), force: true };
    let all = vec![maker(&lcm, "host/b"), connect("host/b/made", "host/a/value"), remove];
    let refusal = ask(&gcm, all).await.unwrap_err();
    assert_eq!(refusal.reason(), "PART_TAKEN");
    assert!(refusal.to_string().contains("Start host/d is still being carried out"), "{refusal}");
    let after = gcm.graph();
    assert_eq!((&after.connections, after.revision), (&before.connections, before.revision));
    assert!(after.components.keys().eq(before.components.keys()) && lcm.state("host/b").is_none());
    lcm.release("Start host/d");
    starting.await.unwrap().unwrap();
}

#[tokio::test]
async fn another_thread_means_made_anew_with_the_same_wires() {
    let (gcm, lcm) = wired().await;
    let execution = Execution { period_ns: Some(2_000_000), ..Execution::default() };
    let change =
        Request::Configure { id: id("host/a"), patch: serde_json::json!({}), execution: Some(execution) };
    let before = lcm.done().len();
    let done = ask(&gcm, vec![change]).await.unwrap();
    let made = plan_lines(&done.plan).into_iter().find(|l| l.starts_with("+ create")).unwrap();
    assert_eq!(made, "+ create host/a (toy/arm) {period_us: 1000 → 2000}");
    let did = lcm.done().split_off(before);
    let kinds: Vec<&str> = did.iter().map(|d| d.split(' ').next().unwrap()).collect();
    let want =
        ["Disconnect", "Disconnect", "Configure", "Remove", "Create", "Configure", "Connect", "Connect"];
    assert_eq!(kinds, want, "{did:?}");
    assert_eq!(numbers(&gcm.graph()), [1, 2], "the same connections under the same numbers");
    assert_eq!(component(&gcm.graph(), "host/a").execution.period_ns, Some(2_000_000));
}

#[tokio::test]
async fn a_thread_that_cannot_be_had_leaves_everything_as_it_was() {
    let (gcm, lcm) = wired().await;
    let before = gcm.graph();
    // The first Configure leads back to CREATED; it is the one that is refused.
    lcm.refuse("Configure host/a");
    let execution = Execution { period_ns: Some(2_000_000), ..Execution::default() };
    let change =
        Request::Configure { id: id("host/a"), patch: serde_json::json!({}), execution: Some(execution) };
    ask(&gcm, vec![change]).await.unwrap_err();
    let after = gcm.graph();
    assert_eq!(after.connections, before.connections);
    assert_eq!(after.components, before.components);
}

#[tokio::test]
async fn what_was_looked_up_earlier_changes_nothing_when_it_comes_later() {
    let (gcm, lcm) = wired().await;
    let of = |path: &str, number: u64, health: Health| Report {
        number,
        health,
        ..report(&gcm, path, &[], |_| {})
    };
    let health = |graph: &SystemGraph, path: &str| graph.components[&id(path)].health;
    lcm.news.send(News::State(of("host/a", 7, Health::Overrun))).unwrap();
    until(&gcm, "the newer one is entered", |g| health(g, "host/a") == Health::Overrun).await;
    lcm.news.send(News::State(of("host/a", 6, Health::Ok))).unwrap();
    // Entered in turn, so the older one was looked at when this is there.
    lcm.news.send(News::State(of("host/b", 1, Health::Overrun))).unwrap();
    let graph = until(&gcm, "the other one's is entered", |g| health(g, "host/b") == Health::Overrun).await;
    assert_eq!(health(&graph, "host/a"), Health::Overrun);
}

#[tokio::test]
async fn what_an_lcm_has_cut_by_itself_is_as_good_as_cut_for_disconnect_and_remove() {
    for forced in [false, true] {
        let (gcm, lcm) = system().await;
        ask(&gcm, ["host/a", "host/b"].map(create).to_vec()).await.unwrap();
        let port = |path: &str| PortId::parse(path).unwrap();
        let (client, server) = (port("host/a/robot"), port("host/b/arm"));
        ask(&gcm, vec![Request::Connect { client, server, options: ConnectOptions::default() }])
            .await
            .unwrap();
        lcm.has_cut("Disconnect host/a/robot from host/b/arm");
        let which = Which::Id(ConnectionId(1));
        let asked = match forced {
            true => Request::Remove { id: id("host/b"), force: true },
            false => Request::Disconnect { which },
        };
        ask(&gcm, vec![asked]).await.unwrap_or_else(|why| panic!("forced {forced}: {why}"));
        assert!(
            lcm.done().iter().any(|done| done == "Disconnect host/a/robot from host/b/arm"),
            "{:?}",
            lcm.done()
        );
        assert!(gcm.graph().connections.is_empty());
    }
}
