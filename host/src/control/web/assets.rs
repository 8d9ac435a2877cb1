//! The viewer's files, built from `host/web` and embedded in the program.
//!
//! Invariant: only embedded bytes are served, by exact name: no path of this machine is ever looked at.

use axum::Extension;
use axum::body::Bytes;
use axum::extract::Path;
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use rust_embed::RustEmbed;

use crate::control::caller::OnlyReads;

/// The built web files.
#[derive(RustEmbed)]
#[folder = "web/dist"]
struct Built;

/// The page, and the mark that tells it its rights.
const PAGE: &str = "index.html";
const FULL: &str = "<meta name=\"viewer\" content=\"full\"";
const ONLY_READS: &str = "<meta name=\"viewer\" content=\"read-only\"";

/// Scripts, data and pictures come from here only; nobody may frame the page. The graph's library sets styles
/// of elements.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; style-src-attr 'unsafe-inline'; \
     img-src 'self' blob: data:; font-src 'self'; connect-src 'self'; worker-src 'self'; manifest-src 'self'; \
     base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Every page is the same file: it looks at its own address.
pub(super) async fn page(limit: Option<Extension<OnlyReads>>) -> Response {
    match (limit, Built::get(PAGE)) {
        (Some(_), Some(found)) => {
            let told = String::from_utf8_lossy(&found.data).replacen(FULL, ONLY_READS, 1);
            answer(PAGE, "no-cache", told.into())
        }
        _ => file(PAGE, "no-cache"),
    }
}

/// Names there carry a hash of the content.
pub(super) async fn asset(Path(name): Path<String>) -> Response {
    file(&format!("assets/{name}"), "public, max-age=31536000, immutable")
}

/// Serves a file beside the page, such as its icon.
pub(super) async fn beside(Path(name): Path<String>) -> Response {
    file(&name, "no-cache")
}

fn file(name: &str, cache: &'static str) -> Response {
    let Some(found) = Built::get(name) else {
        let said = format!(
            "/{name} is not a file of the viewer, which is at /; the video is at /video, for programs at /video.mjpeg.\n"
        );
        return (StatusCode::NOT_FOUND, said).into_response();
    };
    let body = match found.data {
        std::borrow::Cow::Borrowed(bytes) => Bytes::from_static(bytes),
        std::borrow::Cow::Owned(bytes) => Bytes::from(bytes),
    };
    answer(name, cache, body)
}

fn answer(name: &str, cache: &'static str, body: Bytes) -> Response {
    let headers = [
        (CONTENT_TYPE, HeaderValue::from_static(kind(name))),
        (CACHE_CONTROL, HeaderValue::from_static(cache)),
        (CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY)),
        (X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")),
        (REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
    ];
    (headers, body).into_response()
}

fn kind(name: &str) -> &'static str {
    match name.rsplit_once('.').map_or("", |(_, end)| end) {
        "html" => "text/html; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "json" | "webmanifest" => "application/json",
        "txt" | "md" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn every_file_that_was_built_has_a_kind_browsers_take_under_nosniff() {
        let names: Vec<_> = Built::iter().collect();
        assert!(names.iter().any(|n| n == "index.html"), "the viewer is not built: {names:?}");
        for name in names {
            assert_ne!(kind(&name), "application/octet-stream", "{name}");
        }
    }

    #[tokio::test]
    async fn a_page_that_only_reads_is_told_so() {
        for (limit, told) in [(None, FULL), (Some(Extension(OnlyReads::Page)), ONLY_READS)] {
            let body = axum::body::to_bytes(page(limit).await.into_body(), 1 << 20).await.unwrap();
            let page = String::from_utf8(body.to_vec()).unwrap();
            assert_eq!(page.matches("<meta name=\"viewer\"").count(), 1, "{page}");
            assert!(page.contains(told), "{page}");
        }
    }

    #[test]
    fn the_page_names_only_files_that_are_embedded() {
        let page = Built::get("index.html").unwrap();
        let page = String::from_utf8(page.data.to_vec()).unwrap();
        let named: Vec<&str> =
            page.split('"').filter_map(|part| part.strip_prefix("/assets/").map(|_| &part[1..])).collect();
        assert!(!named.is_empty(), "{page}");
        for name in named {
            assert!(Built::get(name).is_some(), "{name} is named by the page and was not built");
        }
    }
}
