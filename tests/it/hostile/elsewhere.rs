//! Processes that cannot be reached: their cards are of another machine, another user, another release.

use serde_json::{Value, json};
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::sync::mpsc;
use tonic::codegen::tokio_stream::wrappers::ReceiverStream;
use tonic::transport::server::TcpIncoming;
use tonic::transport::{Channel, Endpoint, Server};
use tonic::{Request, Response, Status, Streaming};
use trocar_links::LAYOUT;
use trocar_proto::v1::attach_request::Message;
use trocar_proto::v1::attach_service_client::AttachServiceClient;
use trocar_proto::v1::attach_service_server::{AttachService, AttachServiceServer};
use trocar_proto::v1::{
    AttachRequest, AttachResponse, Card, FeedRequest, FeedResponse, SuperviseRequest, SuperviseResponse,
    TellRequest, TellResponse,
};
use trocar_tests::HostProcess;

use super::{Lab, await_nothing_left, holds, lines};

type Change = fn(&mut Card);
type Answer<T> = Result<Response<T>, Status>;

/// Passes on what a process and its GCM say, and changes the card in its Hello.
struct Forger {
    gcm: AttachServiceClient<Channel>,
    change: Change,
}

#[tonic::async_trait]
impl AttachService for Forger {
    type AttachStream = Streaming<AttachResponse>;
    type FeedStream = Streaming<FeedResponse>;
    type SuperviseStream = Streaming<SuperviseResponse>;

    async fn attach(&self, request: Request<Streaming<AttachRequest>>) -> Answer<Self::AttachStream> {
        let (tell, told) = mpsc::channel(64);
        let (mut said, change) = (request.into_inner(), self.change);
        tokio::spawn(async move {
            while let Ok(Some(mut message)) = said.message().await {
                if let Some(Message::Hello(hello)) = &mut message.message {
                    change(hello.inventory.as_mut().unwrap().card.as_mut().unwrap());
                }
                if tell.send(message).await.is_err() {
                    return;
                }
            }
        });
        self.gcm.clone().attach(ReceiverStream::new(told)).await
    }

    async fn feed(&self, request: Request<Streaming<FeedRequest>>) -> Answer<Self::FeedStream> {
        let (tell, told) = mpsc::channel(64);
        let mut said = request.into_inner();
        tokio::spawn(async move {
            while let Ok(Some(message)) = said.message().await {
                if tell.send(message).await.is_err() {
                    return;
                }
            }
        });
        self.gcm.clone().feed(ReceiverStream::new(told)).await
    }

    async fn tell(&self, request: Request<TellRequest>) -> Answer<TellResponse> {
        self.gcm.clone().tell(request).await
    }

    async fn supervise(&self, request: Request<SuperviseRequest>) -> Answer<Self::SuperviseStream> {
        self.gcm.clone().supervise(request).await
    }
}

/// Where a process attaches whose card is to be another one.
struct Forge {
    address: String,
    _runtime: Runtime,
}

impl Forge {
    fn before(gcm: &HostProcess, change: Change) -> Forge {
        let runtime = Runtime::new().unwrap();
        let address = runtime.block_on(async {
            let channel = Endpoint::from_shared(format!("http://{}", gcm.address())).unwrap().connect_lazy();
            let forger = Forger { gcm: AttachServiceClient::new(channel), change };
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let address = listener.local_addr().unwrap().to_string();
            let incoming = TcpIncoming::from(listener).with_nodelay(Some(true));
            let service = AttachServiceServer::new(forger);
            tokio::spawn(Server::builder().add_service(service).serve_with_incoming(incoming));
            address
        });
        Forge { address, _runtime: runtime }
    }
}

/// What a request could have changed.
fn made(lab: &Lab) -> (Value, Value) {
    let list = lab.grpc.ok("GcmService/List", json!({}));
    (list["revision"].clone(), list["connections"].clone())
}

#[test]
fn a_process_of_another_machine_user_or_release_is_refused_each_with_its_sentence_and_nothing_is_made() {
    let lab = Lab::new();
    let mut left = lab.host("left");
    lab.furnish("left");
    lab.start("left");
    let user = rustix::process::geteuid().as_raw();
    let cards: [(&str, Change, String); 3] = [
        (
            "moved",
            |card| card.boot = "11111111-2222-3333-4444-555555555555".into(),
            "moved runs on another machine, or this one was started anew since".into(),
        ),
        (
            "foreign",
            |card| card.uid += 1,
            format!("foreign runs as user {}, this process as {user}: both must", user + 1),
        ),
        (
            "newer",
            |card| card.layout += 1,
            format!("newer lays shared memory out in version {}, this process in {LAYOUT}", LAYOUT + 1),
        ),
    ];
    for (name, change, why) in cards {
        let forge = Forge::before(&lab.gcm, change);
        let mut host = HostProcess::start_with(&lab.world, name, &["--gcm", &forge.address]);
        lab.furnish(name);
        lab.start(name);
        let (before, held) = (made(&lab), [&left, &host].map(|host| holds(host.pid())));
        // Each of them once as the server's process, which is asked first, and as the client's, when the
        // server's half is made.
        for (client, server) in [(name, "left"), ("left", name)] {
            for (to, from) in [("e/sample", "s/value"), ("client/Required", "server/Provided")] {
                for carrier in ["", "memfd"] {
                    let (client, server) = (format!("{client}/{to}"), format!("{server}/{from}"));
                    let body =
                        json!({ "client": client, "server": server, "options": { "carrier": carrier } });
                    let refused = lab.refused(&body);
                    assert_eq!(refused.reason, "UNREACHABLE", "{client} → {server}: {refused}");
                    assert!(refused.message.contains(&why), "{client} → {server}: {refused}");
                    assert!(refused.message.contains(&client), "which one: {refused}");
                }
            }
        }
        assert_eq!(made(&lab), before, "it was refused, and something was made");
        for (host, held) in [&left, &host].into_iter().zip(held) {
            await_nothing_left(host, held);
        }
        assert_eq!(lines(&lab.gcm, "undoing connection"), 0, "{}", lab.gcm.printed());
        assert!(left.is_alive() && host.is_alive());
        lab.await_steps("left/s", 10);
        lab.await_steps(&format!("{name}/s"), 10);
    }
    // The same ends are free for one that can be reached.
    let _right = lab.host("right");
    lab.furnish("right");
    lab.connect("right", "left");
    lab.connect("left", "right");
    lab.start_all("right");
    lab.await_flow("right/e/sample");
    lab.await_flow("left/e/sample");
    lab.await_flow("right/client/Required");
}
