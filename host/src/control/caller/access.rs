//! The rights of a caller: to ask everything, what its certificate says, or only reading methods.
//!
//! Invariant: a method without a row in `rights.rs` changes something, so a new method is refused to callers
//! that only read until it has one.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header::AUTHORIZATION;
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use http_body_util::BodyExt;
use parking_lot::Mutex;
use tokio::sync::Semaphore;
use tonic::Status;
use trocar_links::Seldom;
use trocar_model::Refusal;
use trocar_net::Role;
use trocar_rt::os::now_ns;

use super::rights::{Right, is_of_components, is_own, may, needed, right};
use super::{Peer, PortRules, Viewer};
use crate::control::kind::{is_grpc, is_native};
use crate::control::services::FOR_COMPONENT;
use crate::control::status::status;
use crate::runtime_dir::RuntimeDir;

/// The rule by which callers of a port are let in.
#[derive(Debug)]
pub(crate) struct Access {
    pub(crate) rules: PortRules,
    /// The user whose programs may do everything.
    pub(crate) user: u32,
    /// The directory of that user's token; `None`: no token opens this port.
    pub(crate) tokens: Option<RuntimeDir>,
    /// A caller cannot fill the log.
    pub(crate) refused: Mutex<Seldom>,
    /// Places for open requests of callers that only read, all of them together: the host has other callers.
    pub(crate) readers: Arc<Semaphore>,
}

/// Requests that those who only read may have open at once, streams among them.
pub(crate) const READERS: usize = 64;

/// The caller may only read; a method that can do both may only read for it. Says why.
#[derive(Clone, Debug)]
pub(crate) enum OnlyReads {
    /// A page, where pages only read.
    Page,
    /// A program of a user without further rights.
    Caller { who: String, user: u32 },
    /// One whose certificate lets it read, beside what else it may.
    Holder { who: String },
}

/// The caller has the rights of its certificate.
#[derive(Clone, Debug)]
struct Bounded {
    who: String,
    role: Role,
    /// It asks what components can ask for, in the name of one of a process that it may be.
    for_own: bool,
}

/// Bounds of what a caller may ask.
enum Limit {
    Reads(OnlyReads),
    Role(Bounded),
}

impl OnlyReads {
    /// Tells whether the method of this path is open to such a caller.
    fn may_ask(&self, path: &str) -> bool {
        match self {
            OnlyReads::Holder { .. } => may(Role::Viewer, right(path), false),
            OnlyReads::Page | OnlyReads::Caller { .. } => right(path) == Some(Right::Reads),
        }
    }

    /// Returns the refusal of `what`, which changes something, to such a caller.
    pub(crate) fn refusal(&self, what: String) -> Refusal {
        match self {
            OnlyReads::Page => Refusal::ReadOnly { what },
            OnlyReads::Caller { who, user } => Refusal::Forbidden { what, caller: who.clone(), user: *user },
            OnlyReads::Holder { who } => {
                let needs = needed(Some(Right::Operates));
                Refusal::RoleForbidden { what, caller: who.clone(), needs }
            }
        }
    }
}

impl Access {
    /// `asked`: the path of the request. `None`: everything.
    fn limit(&self, peer: Option<&Peer>, headers: &HeaderMap, native: bool, asked: &str) -> Option<Limit> {
        if self.rules.viewer == Viewer::ReadOnly && !native {
            return Some(Limit::Reads(OnlyReads::Page));
        }
        if let Some((peer, holder)) = peer.and_then(|peer| Some((peer, peer.holder()?))) {
            let who = peer.to_string();
            let component = headers.get(FOR_COMPONENT).and_then(|path| path.to_str().ok());
            let for_own = is_own(holder, component) && is_of_components(asked);
            return match holder.role {
                Role::Viewer => Some(Limit::Reads(OnlyReads::Holder { who })),
                role => Some(Limit::Role(Bounded { who, role, for_own })),
            };
        }
        if self.rules.open_loopback || peer.is_some_and(|peer| peer.is_of(self.user)) {
            return None;
        }
        let who = peer.map_or_else(|| "an unknown caller".to_owned(), Peer::to_string);
        let who = match sent(headers) {
            Some(token) if self.is_token(token) => return None,
            Some(_) => format!("{who}, with a token that is not this host's,"),
            None => who,
        };
        Some(Limit::Reads(OnlyReads::Caller { who, user: self.user }))
    }

    fn is_token(&self, sent: &str) -> bool {
        let Some(tokens) = &self.tokens else { return false };
        let known = tokens.known_token();
        let known =
            known.inspect_err(|e| log::warn!("a token was sent, and this host's cannot be read: {e}"));
        known.is_ok_and(|known| is_same(known.as_bytes(), sent.as_bytes()))
    }
}

fn sent(headers: &HeaderMap) -> Option<&str> {
    headers.get(AUTHORIZATION)?.to_str().ok()?.strip_prefix("Bearer ").map(str::trim)
}

/// Takes as long whichever byte differs.
fn is_same(known: &[u8], sent: &[u8]) -> bool {
    known.len() == sent.len() && known.iter().zip(sent).fold(0, |all, (a, b)| all | (a ^ b)) == 0
}

/// Stands before everything, pages and services: marks requests of a caller that only reads.
pub(crate) async fn known(State(access): State<Arc<Access>>, mut request: Request, next: Next) -> Response {
    let peer = request.extensions().get::<Peer>();
    match access.limit(peer, request.headers(), is_native(&request), request.uri().path()) {
        Some(Limit::Reads(limit)) => _ = request.extensions_mut().insert(limit),
        Some(Limit::Role(limit)) => {
            if limit.role == Role::Host && !limit.for_own {
                // Which command it calls is looked at where that is known.
                request.extensions_mut().insert(OnlyReads::Holder { who: limit.who.clone() });
            }
            request.extensions_mut().insert(limit);
        }
        None => {}
    }
    next.run(request).await
}

/// Stands before the services: refuses such a caller every method that is not listed, whatever the request
/// says about itself. The services ask neither for a verb nor for a kind of content.
pub(crate) async fn only_reads(State(access): State<Arc<Access>>, request: Request, next: Next) -> Response {
    let asked = request.uri().path();
    let verb = || asked.rsplit('/').next().unwrap_or_default().to_owned();
    if let Some(Bounded { who, role, for_own }) = request.extensions().get() {
        let right = right(asked);
        if may(*role, right, *for_own) {
            return next.run(request).await;
        }
        let refusal = Refusal::RoleForbidden { what: verb(), caller: who.clone(), needs: needed(right) };
        access.refused.lock().warn(now_ns(), &refusal.to_string());
        return status(&refusal).into_http::<Body>();
    }
    match request.extensions().get::<OnlyReads>() {
        Some(limit) if !limit.may_ask(asked) => {
            let refusal = limit.refusal(verb());
            access.refused.lock().warn(now_ns(), &refusal.to_string());
            status(&refusal).into_http::<Body>()
        }
        Some(OnlyReads::Caller { .. } | OnlyReads::Holder { .. }) => {
            match access.readers.clone().try_acquire_owned() {
                // Held by the answer until its last part has gone.
                Ok(permit) => next.run(request).await.map(|body| {
                    Body::new(body.map_frame(move |frame| {
                        let _held = &permit;
                        frame
                    }))
                }),
                Err(_) => {
                    let said = format!(
                        "those who only read have {READERS} requests open here, which is all they get: end some, or ask again"
                    );
                    // A program that reads video looks at the HTTP status alone.
                    if is_grpc(request.headers()) {
                        Status::resource_exhausted(said).into_http::<Body>()
                    } else {
                        (StatusCode::SERVICE_UNAVAILABLE, said + "\n").into_response()
                    }
                }
            }
        }
        _ => next.run(request).await,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::convert::Infallible;
    use std::sync::mpsc;
    use std::task::{Context, Poll};

    use axum::http::{Method, Version};
    use tonic::codegen::Service;
    use tonic::server::NamedService;
    use tonic::service::Routes;

    use super::super::{From, Peer};
    use super::*;
    use crate::control::web::with_page;

    /// Asks as an unknown caller, in each way the services would answer; returns the methods that ran.
    async fn ran(path: &str) -> Vec<String> {
        let mut ran = Vec::new();
        for verb in [Method::POST, Method::GET, Method::PUT] {
            for (version, kind) in [
                (Version::HTTP_2, Some("application/grpc")),
                (Version::HTTP_2, Some("text/plain")),
                (Version::HTTP_2, None),
                (Version::HTTP_2, Some("application/grpc-web+proto")),
                (Version::HTTP_11, Some("application/grpc-web-text")),
                (Version::HTTP_11, Some("application/grpc")),
            ] {
                let mut services = Routes::builder();
                let (tell, told) = mpsc::channel();
                services.add_service(Says(tell));
                let mut port = with_page(services.routes(), None, access(None));
                let mut request = axum::http::Request::builder().method(&verb).version(version).uri(path);
                request = request.header("host", "localhost:1");
                request =
                    kind.into_iter().fold(request, |request, kind| request.header("content-type", kind));
                port.call(request.body(tonic::body::Body::empty()).unwrap()).await.unwrap();
                ran.extend(told.try_iter().map(|path: String| format!("{verb} {version:?} {kind:?} {path}")));
            }
        }
        ran
    }

    /// A service that runs whatever it is asked.
    #[derive(Clone)]
    struct Says(mpsc::Sender<String>);

    impl NamedService for Says {
        const NAME: &'static str = "trocar.v1.GcmService";
    }

    impl Service<axum::http::Request<tonic::body::Body>> for Says {
        type Response = axum::http::Response<tonic::body::Body>;
        type Error = Infallible;
        type Future = std::future::Ready<Result<Self::Response, Infallible>>;

        fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
            Poll::Ready(Ok(()))
        }

        fn call(&mut self, request: axum::http::Request<tonic::body::Body>) -> Self::Future {
            self.0.send(request.uri().path().to_owned()).unwrap();
            std::future::ready(Ok(axum::http::Response::default()))
        }
    }

    #[tokio::test]
    async fn no_kind_of_request_reaches_a_method_that_changes_something() {
        for path in
            ["/trocar.v1.GcmService/Create", "/trocar.v1.GcmService/Stop", "/trocar.v1.GcmService/New"]
        {
            assert_eq!(ran(path).await, Vec::<String>::new());
        }
        let reads = ran("/trocar.v1.GcmService/List").await;
        assert!(reads.iter().any(|asked| asked.contains("application/grpc\"")), "{reads:?}");
    }

    fn peer(uid: Option<u32>) -> Peer {
        Peer { from: From::Address(([127, 0, 0, 1], 4242).into()), uid, holder: None, is_cut: Arc::default() }
    }

    const LIST: &str = "/trocar.v1.GcmService/List";

    /// A certificate of a host, with which a request comes for this component.
    fn of_host(component: &str, asked: &str) -> Option<Limit> {
        let (name, processes) = ("cart".to_owned(), vec!["cart".to_owned()]);
        let holder = Arc::new(trocar_net::Holder { name, role: Role::Host, processes, serial: vec![1] });
        let peer = Peer::of_holder(holder, ([10, 0, 0, 7], 4242).into());
        let mut headers = HeaderMap::new();
        headers.insert(FOR_COMPONENT, component.parse().unwrap());
        access(None).limit(Some(&peer), &headers, true, asked)
    }

    #[test]
    fn a_host_asks_in_the_name_of_its_own_components_what_components_ask_and_nothing_else() {
        let for_own = |component: &str, asked: &str| match of_host(component, asked) {
            Some(Limit::Role(Bounded { role: Role::Host, for_own, .. })) => for_own,
            _ => panic!("{component} {asked}"),
        };
        assert!(for_own("cart/arm", "/trocar.v1.GcmService/Create"));
        assert!(!for_own("left/arm", "/trocar.v1.GcmService/Create"));
        for asked in [
            "/trocar.v1.InteractService/Invoke",
            "/trocar.v1.GuestService/Join",
            LIST.trim_end_matches("List"),
        ] {
            assert_eq!(for_own("cart/arm", asked), asked.starts_with("/trocar.v1.GcmService/"), "{asked}");
        }
    }

    fn reads(limit: Option<Limit>) -> OnlyReads {
        match limit {
            Some(Limit::Reads(limit)) => limit,
            _ => panic!("it may do more than read"),
        }
    }

    fn access(tokens: Option<RuntimeDir>) -> Access {
        Access {
            rules: PortRules::default(),
            user: 1000,
            tokens,
            refused: Mutex::default(),
            readers: Arc::new(Semaphore::new(READERS)),
        }
    }

    fn with(token: &str) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(AUTHORIZATION, format!("Bearer {token}").parse().unwrap());
        headers
    }

    #[test]
    fn the_hosts_user_and_root_may_everything_and_whoever_else_is_told_who_may() {
        let (access, none) = (access(None), HeaderMap::new());
        for uid in [1000, 0] {
            assert!(access.limit(Some(&peer(Some(uid))), &none, true, LIST).is_none(), "{uid}");
        }
        for (caller, named) in [
            (Some(peer(Some(65534))), "user 65534 at 127.0.0.1:4242"),
            (Some(peer(None)), "an unknown user at 127.0.0.1:4242"),
            (None, "an unknown caller"),
        ] {
            let limit = reads(access.limit(caller.as_ref(), &none, true, LIST));
            let refusal = limit.refusal("Create".into());
            assert_eq!(refusal.reason(), "FORBIDDEN");
            let said = refusal.to_string();
            assert!(said.contains(named) && said.contains("user 1000"), "{said}");
        }
    }

    #[test]
    fn a_token_opens_the_port_as_long_as_it_is_the_one_that_lies_there() {
        let temp = tempfile::tempdir().unwrap();
        let tokens = RuntimeDir::at(temp.path());
        let (access, stranger) = (access(Some(tokens.clone())), peer(Some(65534)));
        assert!(access.limit(Some(&stranger), &with("no-token-there"), true, LIST).is_some());
        let token = tokens.token().unwrap();
        assert!(access.limit(Some(&stranger), &with(&token), true, LIST).is_none());
        for wrong in ["", &token[1..], &token.replace(|_: char| true, "0"), &format!("{token}0")] {
            let limit = reads(access.limit(Some(&stranger), &with(wrong), true, LIST));
            let said = limit.refusal("Create".into()).to_string();
            assert!(said.contains("a token that is not this host's"), "{said}");
        }
        std::fs::remove_file(temp.path().join("token")).unwrap();
        assert!(access.limit(Some(&stranger), &with(&token), true, LIST).is_some(), "it was withdrawn");
    }

    #[test]
    fn a_page_that_only_reads_does_so_whoever_opened_it_and_programs_go_on() {
        let rules = PortRules { viewer: Viewer::ReadOnly, ..PortRules::default() };
        let access = Access { rules, ..access(None) };
        let (own, none) = (peer(Some(1000)), HeaderMap::new());
        assert!(matches!(access.limit(Some(&own), &none, false, LIST), Some(Limit::Reads(OnlyReads::Page))));
        assert!(access.limit(Some(&own), &none, true, LIST).is_none());
    }

    #[test]
    fn an_open_port_asks_nobody() {
        let rules = PortRules { open_loopback: true, ..PortRules::default() };
        let access = Access { rules, ..access(None) };
        assert!(access.limit(Some(&peer(Some(65534))), &HeaderMap::new(), true, LIST).is_none());
    }
}
