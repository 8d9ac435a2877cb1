//! What a page that only reads may ask: a list, over every method there is.
//!
//! Invariant: what is not listed is refused, so a method that is new is refused until somebody decides; native gRPC is not asked.

use axum::body::Body;
use axum::extract::Request;
use axum::http::header::CONTENT_TYPE;
use axum::middleware::Next;
use axum::response::Response;
use trocar_model::Refusal;

use super::guard;
use crate::control::server::OnlyReads;
use crate::control::status::status;

/// Methods that change nothing. `Invoke` and `WaitFor` look at the command that is called: see [`OnlyReads`].
const READING: [&str; 14] = [
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
];

/// Refuses a page what would change something, and marks the rest for those methods that can do both.
pub(super) async fn only(mut request: Request, next: Next) -> Response {
    if guard::is_grpc(request.headers()) && !is_native(&request) {
        let asked = request.uri().path();
        if !READING.contains(&asked) {
            let what = asked.rsplit('/').next().unwrap_or_default().to_owned();
            log::warn!("{what} was refused: it came from a page, and the viewer only reads here");
            return status(&Refusal::ReadOnly { what }).into_http::<Body>();
        }
        request.extensions_mut().insert(OnlyReads);
    }
    next.run(request).await
}

/// gRPC-Web is for pages, whoever speaks it.
fn is_native(request: &Request) -> bool {
    let kind = request.headers().get(CONTENT_TYPE).map_or(&b""[..], |kind| kind.as_bytes());
    guard::is_program(request.version(), request.headers()) && !kind.starts_with(b"application/grpc-web")
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::collections::BTreeSet;

    use prost_reflect::DescriptorPool;
    use trocar_proto::FILE_DESCRIPTOR_SET;

    use super::READING;

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
}
