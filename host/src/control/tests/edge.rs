//! Services of the port besides the methods: reflection, health, streams, logs, and the addresses it may
//! listen on.

use std::pin::pin;

use tokio::task::JoinSet;
use tokio_stream::StreamExt;
use tonic::{Code, Status};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;
use tonic_reflection::pb::{v1 as reflection, v1alpha as older};
use trocar_proto::v1;
use trocar_proto::v1::gcm_service_client::GcmServiceClient;
use trocar_proto::v1::guest_service_client::GuestServiceClient;
use trocar_proto::v1::interact_service_client::InteractServiceClient;

use super::super::server::STANDING;
use super::super::{PortRules, ServeConfig, ServeError, Server};
use super::{System, connect, create, in_time, serve, start, stop};

/// Symbols a tool asks for: our services and the error details.
const SYMBOLS: [&str; 3] = ["trocar.v1.GcmService", "trocar.v1.InteractService", "google.rpc.ErrorInfo"];

#[tokio::test]
async fn reflection_v1_knows_services_and_error_details() {
    use reflection::server_reflection_request::MessageRequest as Ask;
    use reflection::server_reflection_response::MessageResponse as Answer;
    let s = System::start().await;
    let mut client = reflection::server_reflection_client::ServerReflectionClient::new(s.channel.clone());
    for symbol in SYMBOLS {
        let ask = Ask::FileContainingSymbol(symbol.into());
        let request = reflection::ServerReflectionRequest { host: String::new(), message_request: Some(ask) };
        let mut answers =
            client.server_reflection_info(tokio_stream::once(request)).await.unwrap().into_inner();
        let answer = answers.message().await.unwrap().unwrap().message_response.unwrap();
        assert!(matches!(answer, Answer::FileDescriptorResponse(_)), "{symbol}: {answer:?}");
    }
}

#[tokio::test]
async fn reflection_v1alpha_knows_services_and_error_details() {
    use older::server_reflection_request::MessageRequest as Ask;
    use older::server_reflection_response::MessageResponse as Answer;
    let s = System::start().await;
    let mut client = older::server_reflection_client::ServerReflectionClient::new(s.channel.clone());
    for symbol in SYMBOLS {
        let ask = Ask::FileContainingSymbol(symbol.into());
        let request = older::ServerReflectionRequest { host: String::new(), message_request: Some(ask) };
        let mut answers =
            client.server_reflection_info(tokio_stream::once(request)).await.unwrap().into_inner();
        let answer = answers.message().await.unwrap().unwrap().message_response.unwrap();
        assert!(matches!(answer, Answer::FileDescriptorResponse(_)), "{symbol}: {answer:?}");
    }
}

#[tokio::test]
async fn every_service_is_healthy() {
    let s = System::start().await;
    let mut client = HealthClient::new(s.channel.clone());
    for service in ["", "trocar.v1.GcmService", "trocar.v1.AttachService", "trocar.v1.PluginService"] {
        let answer = client.check(HealthCheckRequest { service: service.into() }).await.unwrap();
        assert_eq!(answer.into_inner().status, 1, "{service:?} must be SERVING");
    }
}

#[tokio::test]
async fn a_whole_life_of_a_component_through_the_port() {
    let s = System::start().await;
    let mut gcm = s.gcm();
    let made = gcm.create(create("host/a")).await.unwrap().into_inner();
    assert_eq!((made.path.as_str(), made.revision), ("host/a", 1));
    assert!(made.plan[0].starts_with("+ create host/a"), "{:?}", made.plan);
    let dry =
        gcm.start(v1::StartRequest { validate_only: true, ..start("host/a") }).await.unwrap().into_inner();
    assert!(dry.plan[0].starts_with("+ start host/a") && dry.components.is_empty(), "{dry:?}");
    gcm.start(start("host/a")).await.unwrap();
    let list = gcm.list(v1::ListRequest::default()).await.unwrap().into_inner();
    let a = &list.components[0];
    assert_eq!((a.path.as_str(), a.state()), ("host/a", v1::ComponentState::Active));
    assert_eq!(a.stats.as_ref().unwrap().executed, 42, "live figures are part of the list");
    let path = v1::DescribeRequest { path: "host/a".into(), ..Default::default() };
    let described = gcm.describe(path).await.unwrap().into_inner();
    let command = &described.ports.unwrap().provided[0].commands[0];
    let arg = command.arg.as_ref().unwrap();
    assert_eq!((command.kind(), arg.unit.as_str(), arg.max), (v1::CommandKind::Write, "mm", Some(100.0)));
    s.lcm.refuse("Stop host/a");
    gcm.create(create("host/b")).await.unwrap();
    gcm.start(start("host/b")).await.unwrap();
    let stopped = gcm.stop(stop("host/**")).await.unwrap().into_inner();
    assert_eq!(stopped.failed.len(), 1);
    assert!(stopped.failed[0].path == "host/a" && stopped.failed[0].why.contains("cable"), "{stopped:?}");
    assert_eq!(stopped.components.len(), 1);
}

#[tokio::test]
async fn a_watcher_gets_a_snapshot_and_then_what_changes() {
    let s = System::start().await;
    let mut gcm = s.gcm();
    gcm.create(create("host/a")).await.unwrap();
    let mut watch = gcm.watch(v1::WatchRequest::default()).await.unwrap().into_inner();
    let Some(v1::watch_response::News::Snapshot(first)) = watch.message().await.unwrap().unwrap().news else {
        panic!("a watcher that knows nothing needs a snapshot");
    };
    assert_eq!(first.components[0].path, "host/a");
    let remove = v1::RemoveRequest { path: "host/a".into(), ..Default::default() };
    gcm.remove(remove).await.unwrap();
    let Some(v1::watch_response::News::Delta(delta)) = watch.message().await.unwrap().unwrap().news else {
        panic!("then only what changed");
    };
    assert_eq!(delta.removed_components, ["host/a"]);
}

/// Names of everything in an answer of List.
fn names(answer: &v1::ListResponse) -> Vec<String> {
    let processes = answer.processes.iter().map(|p| p.name.clone());
    let components = answer.components.iter().map(|c| c.path.clone());
    let connections = answer.connections.iter().map(|c| format!("connection {}", c.id));
    let classes = answer.classes.iter().map(|c| format!("class {}", c.name));
    processes.chain(components).chain(connections).chain(classes).collect()
}

#[tokio::test]
async fn a_list_in_pages_has_everything_once_also_when_something_is_made_or_goes_meanwhile() {
    let s = System::start().await;
    let mut gcm = s.gcm();
    for name in ["a", "b", "c", "d", "e"] {
        gcm.create(create(&format!("host/{name}"))).await.unwrap();
    }
    let ask = |page_size, page_token: &str| v1::ListRequest {
        classes: true,
        page_size,
        page_token: page_token.into(),
        ..Default::default()
    };
    let whole = gcm.list(ask(0, "")).await.unwrap().into_inner();
    assert!(whole.next_page_token.is_empty() && names(&whole).len() > 6);
    for size in [1, 2, 3, 100] {
        let (mut token, mut all) = (String::new(), Vec::new());
        loop {
            let page = gcm.list(ask(size, &token)).await.unwrap().into_inner();
            let here = names(&page);
            assert!(!here.is_empty() && here.len() <= size as usize, "{here:?}");
            assert_eq!(page.etag, whole.etag, "nothing has changed");
            all.extend(here);
            token = page.next_page_token;
            if token.is_empty() {
                break;
            }
        }
        assert_eq!(all, names(&whole), "pages of {size}");
    }
    // The process, a and b; then b goes and one comes in front of it.
    let first = gcm.list(ask(3, "")).await.unwrap().into_inner();
    gcm.remove(v1::RemoveRequest { path: "host/b".into(), ..Default::default() }).await.unwrap();
    gcm.create(create("host/aa")).await.unwrap();
    let rest = gcm.list(ask(100, &first.next_page_token)).await.unwrap().into_inner();
    assert_eq!(names(&rest)[..3], ["host/c", "host/d", "host/e"]);
    assert_ne!(rest.etag, first.etag, "who cares sees that it changed");

    let other = v1::ListRequest { path: "host/**".into(), ..ask(3, &first.next_page_token) };
    let waits = v1::ListRequest { unless_etag: "x".into(), ..ask(3, &first.next_page_token) };
    for refused in [other, waits, ask(3, "nothing of ours"), ask(-1, "")] {
        let status = gcm.list(refused.clone()).await.expect_err("it goes on with no answer of that kind");
        assert_eq!(status.code(), Code::InvalidArgument, "{refused:?}: {status}");
    }
}

#[tokio::test]
async fn a_watcher_gets_its_snapshot_and_its_deltas_in_pages_if_it_asks_for_them() {
    use v1::watch_response::News;
    let s = System::start().await;
    let mut gcm = s.gcm();
    for name in ["a", "b", "c"] {
        gcm.create(create(&format!("host/{name}"))).await.unwrap();
    }
    let mut watch =
        gcm.watch(v1::WatchRequest { page_size: 2, ..Default::default() }).await.unwrap().into_inner();
    let mut components = Vec::new();
    loop {
        let Some(News::Snapshot(page)) = watch.message().await.unwrap().unwrap().news else {
            panic!("first the whole graph")
        };
        assert!(page.processes.len() + page.components.len() + page.connections.len() <= 2, "{page:?}");
        components.extend(page.components.into_iter().map(|c| c.path));
        if !page.more {
            break;
        }
    }
    assert_eq!(components, ["host/a", "host/b", "host/c"]);
    gcm.remove(v1::RemoveRequest { path: "host/b".into(), ..Default::default() }).await.unwrap();
    let Some(News::Delta(delta)) = watch.message().await.unwrap().unwrap().news else {
        panic!("then what changes")
    };
    assert_eq!((delta.removed_components, delta.more), (vec!["host/b".to_owned()], false));
    let refused = gcm.watch(v1::WatchRequest { page_size: -1, ..Default::default() }).await;
    assert_eq!(refused.expect_err("no such size").code(), Code::InvalidArgument);
}

#[tokio::test]
async fn a_watcher_that_comes_back_goes_on_where_it_was() {
    use v1::watch_response::News;
    let s = System::start().await;
    let mut gcm = s.gcm();
    gcm.create(create("host/a")).await.unwrap();
    let first = async |after: &str| {
        let ask = v1::WatchRequest { after: after.into(), ..Default::default() };
        let mut watch = s.gcm().watch(ask).await.unwrap().into_inner();
        watch.message().await.unwrap().unwrap()
    };
    let listed = gcm.list(v1::ListRequest::default()).await.unwrap().into_inner();
    let all = first("").await;
    assert!(matches!(&all.news, Some(News::Snapshot(all)) if all.components.len() == 1), "{all:?}");
    assert_eq!(all.cursor, listed.cursor, "a place has one name, whoever tells it");

    let same = first(&all.cursor).await;
    assert_eq!(same.news, Some(News::Delta(v1::Delta::default())), "it is told at once that nothing changed");
    gcm.create(create("host/b")).await.unwrap();
    gcm.start(start("host/b")).await.unwrap();
    gcm.remove(v1::RemoveRequest { path: "host/a".into(), ..Default::default() }).await.unwrap();
    let Some(News::Delta(delta)) = first(&listed.cursor).await.news else { panic!("only what has changed") };
    assert_eq!(delta.removed_components, ["host/a"]);
    let paths: Vec<_> = delta.components.iter().map(|c| (c.path.as_str(), c.state())).collect();
    assert_eq!(paths, [("host/b", v1::ComponentState::Active)], "as it is now, and once");

    // Another GCM's place says nothing here; what is none is refused.
    let other = System::start().await;
    let listed = other.gcm().list(v1::ListRequest::default()).await.unwrap().into_inner();
    let anew = first(&listed.cursor).await;
    assert!(matches!(&anew.news, Some(News::Snapshot(all)) if all.components.len() == 1), "{anew:?}");
    for after in ["7", "x-1", "12-", "-", "é"] {
        let ask = v1::WatchRequest { after: after.into(), ..Default::default() };
        let refused = s.gcm().watch(ask).await.expect_err(after);
        assert_eq!(refused.code(), Code::InvalidArgument, "{refused}");
        assert!(refused.message().contains("is no cursor: give that of an answer"), "{refused}");
    }
}

#[tokio::test]
async fn who_names_what_was_listed_is_answered_when_it_is_otherwise() {
    let s = System::start().await;
    let mut gcm = s.gcm();
    gcm.create(create("host/a")).await.unwrap();
    let ask = |path: &str, etag: &str| v1::ListRequest {
        path: path.into(),
        unless_etag: etag.into(),
        ..Default::default()
    };
    let first = gcm.list(ask("host/a", "")).await.unwrap().into_inner();
    assert!(!first.etag.is_empty());
    let brief = v1::ListRequest { brief: true, ..ask("host/a", "") };
    assert_eq!(gcm.list(brief).await.unwrap().into_inner().etag, first.etag, "figures are no part of it");
    let known = gcm.list(ask("host/a", "of another time")).await.unwrap().into_inner();
    assert_eq!(known.etag, first.etag, "it is otherwise already");

    // Changes of other parts are no news, and neither is an accepted request without effect.
    let mut waiting = gcm.clone();
    let asked = ask("host/a", &first.etag);
    let mut answer = tokio::spawn(async move { waiting.list(asked).await.unwrap().into_inner() });
    gcm.create(create("host/b")).await.unwrap();
    gcm.stop(stop("host/a")).await.unwrap();
    tokio::select! {
        biased;
        early = &mut answer => panic!("nothing of host/a has changed: {early:?}"),
        () = tokio::task::yield_now() => {}
    }
    gcm.start(start("host/a")).await.unwrap();
    let changed = answer.await.unwrap();
    assert_eq!(changed.components[0].state(), v1::ComponentState::Active);
    assert_ne!(changed.etag, first.etag);

    let same = in_time(async || {
        let mut soon = tonic::Request::new(ask("host/a", &changed.etag));
        soon.set_timeout(std::time::Duration::from_secs(2));
        gcm.list(soon).await
    });
    let same = same.await.expect("it is answered before the call's deadline").into_inner();
    assert_eq!((same.etag, same.components.len()), (changed.etag, 1));
}

#[tokio::test]
async fn what_a_connection_opens_beyond_its_limit_waits_until_one_of_its_streams_ends() {
    const MOST: usize = 256;
    let s = System::start().await;
    let follow = async || {
        let selections = vec![v1::Selection { path: "host/a".into(), ..Default::default() }];
        s.interact().subscribe(v1::SubscribeRequest { selections }).await.unwrap().into_inner()
    };
    let mut open = Vec::new();
    for _ in 0..MOST {
        open.push(follow().await);
    }
    let mut beyond = pin!(follow());
    // Another connection is answered meanwhile, again and again.
    let mut other = GcmServiceClient::new(connect(&s.server).await);
    for _ in 0..100 {
        tokio::select! {
            biased;
            _ = &mut beyond => panic!("{} streams of one connection were opened", MOST + 1),
            listed = other.list(v1::ListRequest::default()) => drop(listed.unwrap()),
        }
    }
    drop(open.pop());
    drop(beyond.await);
}

#[tokio::test]
async fn a_port_lets_so_much_be_followed_and_no_more_until_somebody_ends() {
    const MOST: usize = 16_384;
    const EACH: usize = 256;
    let s = System::start().await;
    let selection = v1::Selection { path: "host/a".into(), ..Default::default() };
    let ask = |many: usize| v1::SubscribeRequest { selections: vec![selection.clone(); many] };
    let mut open = Vec::new();
    for _ in 0..MOST / EACH {
        open.push(s.interact().subscribe(ask(EACH)).await.unwrap());
    }
    let refused = s.interact().subscribe(ask(1)).await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted);
    assert!(refused.message().contains("16384 outputs and events are followed"), "{refused}");
    drop(open.pop());
    // The request is repeated until the end of the other one is noticed.
    in_time(async || s.interact().subscribe(ask(EACH)).await).await.unwrap();
}

#[tokio::test]
async fn a_port_serves_so_many_watches_and_no_more_until_one_ends() {
    let s = System::start().await;
    let from_now = v1::WatchRequest::default;
    // A further connection is needed when all possible Watches take the streams of the first.
    let mut other = GcmServiceClient::new(connect(&s.server).await);
    let mut open = Vec::new();
    for n in 0..STANDING {
        let gcm = if n % 2 == 0 { s.gcm() } else { other.clone() };
        let mut watch = { gcm }.watch(from_now()).await.unwrap().into_inner();
        assert!(watch.next().await.unwrap().is_ok(), "Watch {n} tells what there is");
        open.push(watch);
    }
    let refused = other.watch(from_now()).await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted);
    assert!(refused.message().contains("256 Watches are open at this port"), "{refused}");
    assert!(refused.message().contains("end some of those calls, or ask List"), "what to do: {refused}");
    // Open watchers are told of changes as ever, and everything else is answered.
    s.gcm().create(create("host/b")).await.unwrap();
    assert!(open[0].next().await.unwrap().is_ok());
    drop(open.pop());
    // The request is repeated until the end of the other one is noticed.
    in_time(async || s.gcm().watch(from_now()).await).await.unwrap();
}

#[tokio::test]
async fn a_port_serves_so_many_calls_that_wait_and_no_more_until_one_ends() {
    let s = System::start().await;
    s.gcm().create(create("host/a")).await.unwrap();
    let listed = s.gcm().list(v1::ListRequest::default()).await.unwrap().into_inner();
    let of_logs = || v1::LogsRequest { follow: true, ..Default::default() };
    let of_list = || v1::ListRequest { unless_etag: listed.etag.clone(), ..Default::default() };
    let of_wait = || v1::WaitForRequest { path: "host/a".into(), ..Default::default() };
    // Each kind has places of its own; one connection has too few streams for all of them.
    let mut others = Vec::new();
    for _ in 0..3 {
        others.push(connect(&s.server).await);
    }
    let gcm = |kind: usize| GcmServiceClient::new(others[kind].clone());
    let mut followed = Vec::new();
    for _ in 0..STANDING {
        let mut interact = InteractServiceClient::new(others[0].clone());
        followed.push(interact.logs(of_logs()).await.unwrap());
    }
    let (mut lists, mut waits) = (JoinSet::new(), JoinSet::new());
    for _ in 0..STANDING {
        let (list, list_of) = (gcm(1), of_list());
        lists.spawn(placed(async move || list.clone().list(list_of.clone()).await));
        let (wait, wait_of) = (gcm(2), of_wait());
        waits.spawn(placed(async move || wait.clone().wait_for(wait_of.clone()).await));
    }
    let refused = s.interact().logs(of_logs()).await.err();
    is_refused(refused.as_ref(), "256 Logs that follow are open", "without `follow`");
    // Some of them may not have come yet.
    let refused = in_time(async || full(s.gcm().list(soon(of_list())).await)).await.ok();
    is_refused(refused.as_ref(), "256 Lists that wait for a change are open", "without unless_etag");
    let refused = in_time(async || full(s.gcm().wait_for(soon(of_wait())).await)).await.ok();
    is_refused(refused.as_ref(), "256 WaitFors are open", "ask Watch");
    // Calls that do not wait are answered as ever, and the waiting ones get their answer.
    s.gcm().list(v1::ListRequest::default()).await.unwrap();
    s.gcm().start(start("host/a")).await.unwrap();
    while let Some(answer) = lists.join_next().await {
        answer.unwrap().unwrap();
    }
    while let Some(answer) = waits.join_next().await {
        answer.unwrap().unwrap();
    }
    followed.pop();
    in_time(async || s.interact().logs(of_logs()).await).await.unwrap();
    in_time(async || s.gcm().wait_for(of_wait()).await).await.unwrap();
}

#[tokio::test]
async fn a_port_serves_so_many_holds_and_no_more_until_one_ends() {
    let s = System::start().await;
    let of = |n: usize| v1::HoldRequest { component: format!("host/h{n}") };
    // A further connection is needed when all possible Holds take the streams of the first.
    let mut other = GuestServiceClient::new(connect(&s.server).await);
    let mut open = Vec::new();
    for n in 0..STANDING {
        open.push(other.hold(of(n)).await.unwrap());
    }
    let mut guest = GuestServiceClient::new(s.channel.clone());
    let refused = guest.hold(of(STANDING)).await.err();
    is_refused(refused.as_ref(), "256 Holds are open", "take the component away yourself");
    drop(open.pop());
    // The request is repeated until the end of the other one is noticed.
    in_time(async || guest.clone().hold(of(STANDING)).await).await.unwrap();
}

/// Asks until there is a place: a caller that looked whether all were taken may have had the last.
async fn placed<T>(mut ask: impl AsyncFnMut() -> Result<T, Status>) -> Result<T, Status> {
    loop {
        match ask().await {
            Err(refused) if is_full(&refused) => tokio::task::yield_now().await,
            answer => return answer,
        }
    }
}

/// Returns the refusal for want of a place; after any other answer the caller asks again.
fn full<T>(answer: Result<T, Status>) -> Result<Status, Status> {
    answer.err().filter(is_full).ok_or_else(|| Status::unavailable("it had a place"))
}

fn is_full(refused: &Status) -> bool {
    refused.code() == Code::ResourceExhausted
}

fn is_refused(refused: Option<&Status>, why: &str, what_to_do: &str) {
    let refused = refused.expect("there is no place for it");
    assert!(is_full(refused), "{refused}");
    assert!(refused.message().contains(why), "{refused}");
    assert!(refused.message().contains(what_to_do), "what to do: {refused}");
}

/// With a deadline that ends it where it has a place.
fn soon<T>(message: T) -> tonic::Request<T> {
    let mut request = tonic::Request::new(message);
    request.set_timeout(std::time::Duration::from_millis(50));
    request
}

#[tokio::test]
async fn logs_are_kept_for_who_asks_later_and_end_unless_followed() {
    let s = System::start().await;
    let path = "host/a";
    s.gcm().create(create(path)).await.unwrap();
    s.lcm.log(path, 3, "one");
    s.lcm.log("host/ab", 3, "another's");
    s.lcm.log(path, 5, "too detailed");
    s.lcm.log(path, 1, "two");
    let request = v1::LogsRequest { path: path.into(), follow: true, ..Default::default() };
    let followed = s.interact().logs(request.clone()).await.unwrap().into_inner();
    let lines: Vec<_> = followed.take(2).map(|line| line.unwrap().line.unwrap().message).collect().await;
    assert_eq!(lines, ["one", "two"]);
    let kept = s.interact().logs(v1::LogsRequest { follow: false, ..request }).await.unwrap().into_inner();
    let lines: Vec<_> = kept.map(|line| line.unwrap().line.unwrap().message).collect().await;
    assert_eq!(lines, ["one", "two"], "without follow it must end");
    for (nobody, says) in [("host/b", "host/a"), ("hots/a", "host"), ("hots", "host")] {
        let request = v1::LogsRequest { path: nobody.into(), follow: true, ..Default::default() };
        let refused = s.interact().logs(request).await.expect_err("nobody is called that");
        assert!(refused.message().contains(says), "{nobody}: it must name who there is: {refused}");
    }
    s.gcm().remove(v1::RemoveRequest { path: path.into(), ..Default::default() }).await.unwrap();
    let request = v1::LogsRequest { path: path.into(), ..Default::default() };
    let left: Vec<_> = s.interact().logs(request).await.unwrap().into_inner().collect().await;
    assert!(left.len() >= 2, "what a component left is shown after it is gone");
}

#[tokio::test]
async fn a_taken_port_and_an_open_address_are_refused_with_what_to_do() {
    let first = serve("127.0.0.1:0", None, None).await;
    let config = |listen: String| ServeConfig {
        listen,
        gcm: None,
        local: None,
        managed_by: None,
        rules: PortRules::default(),
        secured: None,
        runtime: None,
    };
    for (listen, what, remedy) in [
        (first.addr().to_string(), "taken", "--listen"),
        ("0.0.0.0:0".into(), "nobody knows who calls", "--listen-tls"),
    ] {
        let refused = Server::start(config(listen)).await.err().unwrap();
        let ServeError::Unusable { because, help } = &refused else { panic!("{refused:?}") };
        assert!(because.contains(what) && help.contains(remedy), "{refused:?}");
    }
    connect(&first).await;
}
