//! The viewer on the gRPC port: its files, gRPC-Web for it, pictures for programs without gRPC, and the guard
//! that keeps other web sites out.
//!
//! Invariant: every request of a browser passes `guard` first; programs that speak gRPC are served as if
//! there were no page.

mod assets;
mod guard;
mod stream;

use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::http::{Request, StatusCode};
use axum::middleware::{from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use tonic::Status;
use tonic::service::Routes;
use tonic_web::GrpcWebLayer;

use super::caller::{Access, known, only_reads};
use super::kind::is_grpc;
use super::server::Edge;

/// Joins the services, the pictures of `edge` and the page, behind the guard of their rights.
pub(super) fn with_page(services: Routes, edge: Option<Edge>, access: Access) -> Routes {
    let access = Arc::new(access);
    let services = services
        .into_axum_router()
        .layer(GrpcWebLayer::new())
        .reset_fallback()
        .merge(edge.map(stream::route).unwrap_or_default())
        .layer(from_fn_with_state(access.clone(), only_reads));
    let page = Router::new()
        .route("/", get(assets::page))
        .route("/video", get(assets::page))
        .route("/healthz", get(|| async { "ok\n" }))
        .route("/assets/{name}", get(assets::asset))
        .route("/{name}", get(assets::beside));
    let all = services.merge(page).fallback(nothing_there);
    all.layer(from_fn_with_state(access, known)).layer(from_fn(guard::guard)).into()
}

/// Joins the services, behind the guard of their rights.
pub(super) fn without_page(services: Routes, access: Access) -> Routes {
    let access = Arc::new(access);
    let services = services.into_axum_router().layer(from_fn_with_state(access.clone(), only_reads));
    services.layer(from_fn_with_state(access, known)).layer(from_fn(guard::guard)).into()
}

/// gRPC keeps its own answer to unknown paths; other callers are told what exists.
async fn nothing_there(request: Request<Body>) -> Response {
    if is_grpc(request.headers()) {
        return Status::unimplemented("").into_http::<Body>();
    }
    let said = format!(
        "{} is not here. The viewer is at /, the video at /video and /video.mjpeg, a sign of life at /healthz; everything else is gRPC.\n",
        request.uri().path()
    );
    (StatusCode::NOT_FOUND, said).into_response()
}
