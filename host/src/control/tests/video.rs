//! The stream of pictures as programs read it that know nothing of gRPC: over a bare connection.

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use super::System;
use crate::control::{PortRules, Viewer};
use crate::gcm::fake::comes;

const OUTPUT: &str = "host/a/value";
const PART: &str = "Content-Type: image/jpeg\r\nContent-Length: 4\r\n\r\nJPEG\r\n--trocar-frame\r\n";

/// Asks, and returns the answer up to its end; meanwhile a follower gets so many pictures.
async fn asked(s: &System, query: &str, header: &str, pictures: u64) -> String {
    let mut connection = TcpStream::connect(s.server.addr()).await.unwrap();
    let request = format!("GET /video.mjpeg?{query} HTTP/1.0\r\nHost: {}\r\n{header}\r\n", s.server.addr());
    connection.write_all(request.as_bytes()).await.unwrap();
    if pictures > 0 {
        s.lcm.followed(1).await;
    }
    for n in 0..pictures {
        s.lcm.picture(OUTPUT, n, b"JPEG").await;
    }
    let mut answer = Vec::new();
    comes("the end of the answer", connection.read_to_end(&mut answer)).await.unwrap();
    String::from_utf8_lossy(&answer).into_owned()
}

#[tokio::test]
async fn whoever_may_read_gets_pictures_until_they_stand_still() {
    let s = System::start_with(PortRules { viewer: Viewer::ReadOnly, ..PortRules::default() }).await;
    let answer = asked(&s, &format!("path={OUTPUT}"), "", 3).await;
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    assert!(head.starts_with("HTTP/1.") && head.contains(" 200 "), "{head}");
    assert!(head.contains("multipart/x-mixed-replace; boundary=trocar-frame"), "{head}");
    // A reader that is slow may miss some.
    assert_eq!((body.contains(PART), &*body.replace(PART, "")), (true, "--trocar-frame\r\n"), "{body}");
    s.lcm.unfollowed().await;
}

#[tokio::test]
async fn a_request_without_an_answer_is_told_why() {
    let s = System::start().await;
    let other_page = "Sec-Fetch-Site: cross-site\r\nSec-Fetch-Dest: image\r\n";
    for (query, header, status, words) in [
        ("", "", 400, "no display has a picture here: say which with ?path=host/camera/image"),
        ("path=nowhere/a/image", "", 404, "nowhere"),
        ("path=host/a/value&width=0", "", 400, "\"width=0\" is none of path=host/camera/image, width=640"),
        ("path=host/a/value&eye=third", "", 400, "eye=left, right or both"),
        ("path=host%2Fa%2Fvalue", "", 503, "host/a/value gave no picture within 0.3 s: is it running?"),
        ("path=host/a/value", other_page, 403, "only the viewer's own page"),
    ] {
        let said = asked(&s, query, header, 0).await;
        assert!(said.contains(&format!(" {status} ")) && said.contains(words), "{query}: {said}");
    }
}
