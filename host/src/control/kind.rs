//! Kind of a request: gRPC as programs speak it, gRPC of a page, or something else.
//!
//! Invariant: a request with any sign of a browser is none of a program.

use axum::extract::Request;
use axum::http::header::{CONTENT_TYPE, ORIGIN};
use axum::http::{HeaderMap, Version};

/// True for a program that speaks gRPC, without any sign of a browser.
pub(super) fn is_program(version: Version, headers: &HeaderMap) -> bool {
    version == Version::HTTP_2 && !headers.contains_key(ORIGIN) && !headers.contains_key("sec-fetch-site")
}

/// True for gRPC as programs speak it; gRPC-Web is for pages, also when a program speaks it.
pub(super) fn is_native(request: &Request) -> bool {
    let kind = request.headers().get(CONTENT_TYPE).map_or(&b""[..], |kind| kind.as_bytes());
    is_program(request.version(), request.headers()) && !kind.starts_with(b"application/grpc-web")
}

/// True for gRPC in any of its forms.
pub(super) fn is_grpc(headers: &HeaderMap) -> bool {
    text(headers, CONTENT_TYPE.as_str()).is_some_and(|t| t.starts_with("application/grpc"))
}

pub(super) fn text<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    // A header that is no text is judged as one that names nobody.
    headers.get(name).map(|value| value.to_str().unwrap_or_default())
}
