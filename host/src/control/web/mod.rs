//! The viewer on the gRPC port: its files, gRPC-Web for it, and the guard that keeps other web sites out.
//!
//! Invariant: whatever a browser sends passes `guard` first; programs that speak gRPC are served as if there were no page.

mod assets;
mod guard;
mod reading;

use axum::Router;
use axum::body::Body;
use axum::http::{Request, StatusCode};
use axum::middleware::from_fn;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use tonic::Status;
use tonic::service::Routes;
use tonic_web::GrpcWebLayer;

/// What the viewer's page may do on a port.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Viewer {
    /// Whatever anybody may who reaches the port.
    #[default]
    Full,
    /// Look: what comes through a browser changes nothing. Programs that speak gRPC go on as ever.
    ReadOnly,
}

/// The services and the page as one.
pub(super) fn with_page(services: Routes, viewer: Viewer) -> Routes {
    let services = services.into_axum_router().layer(GrpcWebLayer::new()).reset_fallback();
    let page = Router::new()
        .route("/", get(move || assets::page(viewer)))
        .route("/video", get(move || assets::page(viewer)))
        .route("/healthz", get(|| async { "ok\n" }))
        .route("/assets/{name}", get(assets::asset))
        .route("/{name}", get(assets::beside));
    let all = services.merge(page).fallback(nothing_there);
    let all = match viewer {
        Viewer::Full => all,
        Viewer::ReadOnly => all.layer(from_fn(reading::only)),
    };
    all.layer(from_fn(guard::guard)).into()
}

/// gRPC keeps its own answer to what it does not know; everybody else is told what there is.
async fn nothing_there(request: Request<Body>) -> Response {
    if guard::is_grpc(request.headers()) {
        return Status::unimplemented("").into_http::<Body>();
    }
    let said = format!(
        "{} is not here. The viewer is at /, the video at /video, a sign of life at /healthz; everything else is gRPC.\n",
        request.uri().path()
    );
    (StatusCode::NOT_FOUND, said).into_response()
}
