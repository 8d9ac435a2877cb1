//! What a caller may ask: everything, or what reads. A list over every method there is.
//!
//! Invariant: what is not listed changes something, so a method that is new is refused to whoever only reads
//! until somebody decides.

use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::HeaderMap;
use axum::http::header::AUTHORIZATION;
use axum::middleware::Next;
use axum::response::Response;
use trocar_links::Seldom;
use trocar_model::Refusal;
use trocar_rt::os::now_ns;

use super::Peer;
use crate::control::status::status;
use crate::control::web::{PortRules, Viewer, is_grpc, is_native};
use crate::runtime_dir::RuntimeDir;

/// Methods that change nothing. `Invoke` and `WaitFor` look at the command that is called: see [`OnlyReads`].
const READING: [&str; 16] = [
    "/trocar.v1.GcmService/Describe",
    "/trocar.v1.GcmService/GetState",
    "/trocar.v1.GcmService/List",
    "/trocar.v1.GcmService/WaitFor",
    "/trocar.v1.GcmService/Watch",
    "/trocar.v1.InteractService/Invoke",
    "/trocar.v1.InteractService/Logs",
    "/trocar.v1.InteractService/Read",
    "/trocar.v1.InteractService/Subscribe",
    "/trocar.v1.PluginService/DescribePlugin",
    "/trocar.v1.PluginService/ListPlugins",
    "/grpc.health.v1.Health/Check",
    "/grpc.health.v1.Health/List",
    "/grpc.health.v1.Health/Watch",
    "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
    "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
];

/// Who is let in how far on a port.
#[derive(Debug)]
pub(in crate::control) struct Access {
    pub(in crate::control) rules: PortRules,
    /// The user whose programs may do everything.
    pub(in crate::control) user: u32,
    /// Where the token of that user lies; `None`: no token opens this port.
    pub(in crate::control) tokens: Option<RuntimeDir>,
    /// A caller cannot fill the log.
    pub(in crate::control) refused: Mutex<Seldom>,
}

/// The caller may ask only what reads; of a method that can do both it may ask only that. Says why.
#[derive(Clone, Debug)]
pub(in crate::control) enum OnlyReads {
    /// It is a page, and pages only read here.
    Page,
    /// It is nobody's who may do more.
    Caller { who: String, user: u32 },
}

impl OnlyReads {
    /// What such a caller is told about `what`, which changes something.
    pub(in crate::control) fn refusal(&self, what: String) -> Refusal {
        match self {
            OnlyReads::Page => Refusal::ReadOnly { what },
            OnlyReads::Caller { who, user } => Refusal::Forbidden { what, caller: who.clone(), user: *user },
        }
    }
}

impl Access {
    /// `None`: everything.
    fn limit(&self, peer: Option<&Peer>, headers: &HeaderMap, native: bool) -> Option<OnlyReads> {
        if self.rules.viewer == Viewer::ReadOnly && !native {
            return Some(OnlyReads::Page);
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
        Some(OnlyReads::Caller { who, user: self.user })
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

/// Refuses what the caller may not ask, and marks the rest for those methods that can do both.
pub(in crate::control) async fn only_allowed(
    State(access): State<Arc<Access>>,
    mut request: Request,
    next: Next,
) -> Response {
    let peer = request.extensions().get::<Peer>();
    if let Some(limit) = access.limit(peer, request.headers(), is_native(&request)) {
        let asked = request.uri().path();
        // Files of the page are for everybody; the page is told what it may do.
        if is_grpc(request.headers()) && !READING.contains(&asked) {
            let what = asked.rsplit('/').next().unwrap_or_default().to_owned();
            let refusal = limit.refusal(what);
            access
                .refused
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .warn(now_ns(), &refusal.to_string());
            return status(&refusal).into_http::<Body>();
        }
        request.extensions_mut().insert(limit);
    }
    next.run(request).await
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::collections::BTreeSet;

    use prost_reflect::DescriptorPool;
    use trocar_proto::FILE_DESCRIPTOR_SET;

    use super::super::{From, Peer};
    use super::*;

    /// Those that change something; a method in neither list is one nobody has decided about.
    const CHANGING: [&str; 21] = [
        "/trocar.v1.AttachService/Attach",
        "/trocar.v1.AttachService/Supervise",
        "/trocar.v1.AttachService/Tell",
        "/trocar.v1.GcmService/Apply",
        "/trocar.v1.GcmService/Configure",
        "/trocar.v1.GcmService/Connect",
        "/trocar.v1.GcmService/Create",
        "/trocar.v1.GcmService/Disconnect",
        "/trocar.v1.GcmService/Move",
        "/trocar.v1.GcmService/Remove",
        "/trocar.v1.GcmService/Replace",
        "/trocar.v1.GcmService/Reset",
        "/trocar.v1.GcmService/Resume",
        "/trocar.v1.GcmService/Start",
        "/trocar.v1.GcmService/Stop",
        "/trocar.v1.GuestService/Join",
        "/trocar.v1.GuestService/Require",
        "/trocar.v1.InteractService/Emit",
        "/trocar.v1.PluginService/Load",
        "/trocar.v1.PluginService/Reload",
        "/trocar.v1.PluginService/Unload",
    ];

    #[test]
    fn every_method_there_is_either_reads_or_changes() {
        let pool = DescriptorPool::decode(FILE_DESCRIPTOR_SET).unwrap();
        let all: BTreeSet<String> = pool
            .services()
            .flat_map(|s| s.methods().map(|m| format!("/{}/{}", s.full_name(), m.name())).collect::<Vec<_>>())
            .collect();
        let reading = READING.iter().filter(|m| m.starts_with("/trocar."));
        let judged: BTreeSet<String> = reading.chain(&CHANGING).map(|m| (*m).to_owned()).collect();
        assert_eq!(judged, all, "say of a new method whether it reads (READING) or changes something");
    }

    fn peer(uid: Option<u32>) -> Peer {
        Peer { from: From::Address(([127, 0, 0, 1], 4242).into()), uid }
    }

    fn access(tokens: Option<RuntimeDir>) -> Access {
        Access { rules: PortRules::default(), user: 1000, tokens, refused: Mutex::default() }
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
            assert!(access.limit(Some(&peer(Some(uid))), &none, true).is_none(), "{uid}");
        }
        for (caller, named) in [
            (Some(peer(Some(65534))), "user 65534 at 127.0.0.1:4242"),
            (Some(peer(None)), "an unknown user at 127.0.0.1:4242"),
            (None, "an unknown caller"),
        ] {
            let limit = access.limit(caller.as_ref(), &none, true).unwrap();
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
        assert!(access.limit(Some(&stranger), &with("no-token-there"), true).is_some());
        let token = tokens.token().unwrap();
        assert!(access.limit(Some(&stranger), &with(&token), true).is_none());
        for wrong in ["", &token[1..], &token.replace(|_: char| true, "0"), &format!("{token}0")] {
            let limit = access.limit(Some(&stranger), &with(wrong), true).unwrap();
            let said = limit.refusal("Create".into()).to_string();
            assert!(said.contains("a token that is not this host's"), "{said}");
        }
        std::fs::remove_file(temp.path().join("token")).unwrap();
        assert!(access.limit(Some(&stranger), &with(&token), true).is_some(), "it was withdrawn");
    }

    #[test]
    fn a_page_that_only_reads_does_so_whoever_opened_it_and_programs_go_on() {
        let rules = PortRules { viewer: Viewer::ReadOnly, ..PortRules::default() };
        let access = Access { rules, ..access(None) };
        let (own, none) = (peer(Some(1000)), HeaderMap::new());
        assert!(matches!(access.limit(Some(&own), &none, false), Some(OnlyReads::Page)));
        assert!(access.limit(Some(&own), &none, true).is_none());
    }

    #[test]
    fn an_open_port_asks_nobody() {
        let rules = PortRules { open_loopback: true, ..PortRules::default() };
        let access = Access { rules, ..access(None) };
        assert!(access.limit(Some(&peer(Some(65534))), &HeaderMap::new(), true).is_none());
    }
}
