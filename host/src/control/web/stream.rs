//! The picture as a stream of JPEGs over HTTP, for programs that read video from an address, as VLC and
//! OpenCV do.
//!
//! Invariant: it is a Subscribe with that call's limits. No program takes an old picture for a live one: a
//! slow one gets the newest, and the stream ends when the picture stands still.

use std::convert::Infallible;
use std::time::Duration;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, X_CONTENT_TYPE_OPTIONS};
use axum::http::{StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use tokio::sync::watch;
use tokio::time::{Instant, timeout_at};
use tokio_stream::wrappers::WatchStream;
use tokio_stream::{Stream, StreamExt, once};
use tonic::{Code, Request, Status};
use trocar_proto::v1;
use trocar_proto::v1::interact_service_server::InteractService;

use crate::control::server::Edge;
use crate::gcm::Gcm;

/// A picture that stands still for so long ends the stream.
const STILL: Duration = Duration::from_millis(if cfg!(test) { 300 } else { 2000 });
const MOST_HZ: f64 = 30.0;
const WIDTH_PX: u32 = 1024;
const KIND: &str = "multipart/x-mixed-replace; boundary=trocar-frame";
/// Sent behind each picture, too: a browser shows a picture when it sees where it ends.
const BOUNDARY: &str = "--trocar-frame\r\n";

pub(super) fn route(edge: Edge) -> Router {
    Router::new().route("/video.mjpeg", get(pictures)).with_state(edge)
}

async fn pictures(State(edge): State<Edge>, uri: Uri) -> Response {
    let asked = selection(uri.query().unwrap_or_default(), || edge.gcm.as_ref().and_then(surgeons));
    let selection = match asked {
        Ok(selection) => selection,
        Err(why) => return said(StatusCode::BAD_REQUEST, &why),
    };
    let path = selection.path.clone();
    let request = Request::new(v1::SubscribeRequest { selections: vec![selection] });
    let items = match edge.subscribe(request).await {
        Ok(items) => items.into_inner(),
        Err(status) => return said(as_http(status.code()), status.message()),
    };
    let mut jpegs = Box::pin(newest(items).take_while(|jpeg| !jpeg.is_empty()));
    let Some(first) = jpegs.next().await else {
        let why = format!("{path} gave no picture within {} s: is it running?", STILL.as_secs_f64());
        return said(StatusCode::SERVICE_UNAVAILABLE, &why);
    };
    let parts = once(BOUNDARY.into()).chain(once(first).chain(jpegs).map(part));
    let headers = [(CONTENT_TYPE, KIND), (CACHE_CONTROL, "no-store"), (X_CONTENT_TYPE_OPTIONS, "nosniff")];
    (headers, Body::from_stream(parts.map(Ok::<Bytes, Infallible>))).into_response()
}

/// The newest picture, whenever its reader is ready for one; an empty one when it stands still, however long
/// the reader does not look.
fn newest(
    mut items: impl Stream<Item = Result<v1::SubscribeResponse, Status>> + Send + Unpin + 'static,
) -> WatchStream<Vec<u8>> {
    let (show, shown) = watch::channel(Vec::new());
    tokio::spawn(async move {
        let mut still = Instant::now() + STILL;
        loop {
            let item = tokio::select! {
                () = show.closed() => return,
                item = timeout_at(still, items.next()) => item,
            };
            match item {
                Ok(Some(Ok(item))) if item.jpeg.is_empty() => {}
                Ok(Some(Ok(item))) => {
                    still = Instant::now() + STILL;
                    show.send_replace(item.jpeg);
                }
                Ok(Some(Err(_)) | None) | Err(_) => break,
            }
        }
        show.send_replace(Vec::new());
    });
    WatchStream::from_changes(shown)
}

fn part(jpeg: Vec<u8>) -> Bytes {
    let head = format!("Content-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", jpeg.len());
    [head.as_bytes(), &jpeg, b"\r\n", BOUNDARY.as_bytes()].concat().into()
}

/// The selection that a query asks for: `path=…&width=…&eye=…`, all optional.
fn selection(query: &str, shown: impl FnOnce() -> Option<String>) -> Result<v1::Selection, String> {
    let (mut path, mut width, mut eye) = (None, WIDTH_PX, v1::Eye::Left);
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        let bad =
            || format!("{pair:?} is none of path=host/camera/image, width=640 (px), eye=left, right or both");
        match pair.split_once('=').ok_or_else(bad)? {
            // Names have no other character that is written like this.
            ("path", value) => path = Some(value.replace("%2F", "/").replace("%2f", "/")),
            ("width", value) => width = value.parse().ok().filter(|px| *px > 0).ok_or_else(bad)?,
            ("eye", "left") => eye = v1::Eye::Left,
            ("eye", "right") => eye = v1::Eye::Right,
            ("eye", "both") => eye = v1::Eye::Both,
            _ => return Err(bad()),
        }
    }
    let path =
        path.or_else(shown).ok_or("no display has a picture here: say which with ?path=host/camera/image")?;
    Ok(v1::Selection { path, max_rate_hz: MOST_HZ, thumbnail_width: width, eye: eye.into() })
}

/// The output that goes into a display, as `/video` finds it.
fn surgeons(gcm: &Gcm) -> Option<String> {
    let graph = gcm.graph();
    let of = |id| graph.components.get(id).is_some_and(|component| component.class.name == "display");
    graph.connections.values().find(|c| of(&c.client.component)).map(|c| c.server.to_string())
}

fn as_http(code: Code) -> StatusCode {
    match code {
        Code::NotFound => StatusCode::NOT_FOUND,
        Code::InvalidArgument => StatusCode::BAD_REQUEST,
        Code::PermissionDenied => StatusCode::FORBIDDEN,
        _ => StatusCode::SERVICE_UNAVAILABLE,
    }
}

fn said(status: StatusCode, why: &str) -> Response {
    (status, format!("{why}\n")).into_response()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use tokio::sync::mpsc;
    use tokio_stream::wrappers::ReceiverStream;

    use super::*;

    #[test]
    fn a_query_names_path_width_and_eye() {
        let shown = || Some("host/microscope/image".to_owned());
        let eye = |query: &str| selection(query, shown).unwrap().eye();
        assert_eq!(eye(""), v1::Eye::Left);
        for (word, meant) in [("left", v1::Eye::Left), ("right", v1::Eye::Right), ("both", v1::Eye::Both)] {
            assert_eq!(eye(&format!("width=640&eye={word}")), meant, "{word}");
            let sent = selection(&format!("eye={word}"), shown).unwrap();
            let kept = crate::control::convert::selection_out(
                crate::control::convert::selection(sent.clone()).unwrap(),
            );
            assert_eq!(kept, sent, "{word}: as it was, on its way to another process");
        }
        let unknown = v1::Selection { eye: 9, ..selection("", shown).unwrap() };
        let refused = crate::control::convert::selection(unknown).unwrap_err();
        assert!(refused.to_string().contains("EYE_LEFT, EYE_RIGHT or EYE_BOTH"), "{refused}");
    }

    #[tokio::test]
    async fn a_reader_that_looks_late_is_shown_the_end_and_no_old_picture() {
        let (give, items) = mpsc::channel(1);
        let mut shown = newest(ReceiverStream::new(items));
        let picture = v1::SubscribeResponse { jpeg: b"old".to_vec(), ..v1::SubscribeResponse::default() };
        give.send(Ok(picture)).await.unwrap();
        // No more are taken once they stand still.
        give.closed().await;
        assert_eq!(shown.next().await, Some(Vec::new()));
        assert_eq!(shown.next().await, None);
    }
}
