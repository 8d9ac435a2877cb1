//! InteractService: calls, reads, what is followed, logs.

use std::pin::Pin;
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt};
use tonic::{Request, Response, Status};
use trocar_model::{MemberId, Name, Refusal};
use trocar_proto::v1;
use trocar_proto::v1::interact_service_server::InteractService;

use super::{Edge, not_built, refuse};
use crate::control::convert;
use crate::control::deadline::deadline;
use crate::lcm::{Invoke, Item, ItemKind, LogLine, News, Payload, Selection};

type Items = Pin<Box<dyn Stream<Item = Result<v1::SubscribeResponse, Status>> + Send>>;
type Lines = Pin<Box<dyn Stream<Item = Result<v1::LogsResponse, Status>> + Send>>;

/// Items one caller may have waiting.
const WAITING: usize = 256;

/// The process a path begins with.
fn process_of(path: &str) -> Result<Name, Refusal> {
    Name::parse(path.split('/').next().unwrap_or_default())
        .map_err(|_| Refusal::BadPath { text: path.into(), why: "it begins with no process name".into() })
}

#[tonic::async_trait]
impl InteractService for Edge {
    async fn invoke(&self, request: Request<v1::InvokeRequest>) -> Result<Response<v1::InvokeResponse>, Status> {
        let until = deadline(&request);
        let r = request.into_inner();
        let member = MemberId::parse(&r.path).map_err(refuse)?;
        let left = u64::try_from(until.saturating_duration_since(Instant::now()).as_nanos()).unwrap_or(u64::MAX);
        let asked = r.deadline.as_ref().map(|d| {
            convert::duration_ns(d).ok_or_else(|| {
                refuse(Refusal::ArgumentInvalid {
                    what: "deadline".into(),
                    why: "it must not be negative".into(),
                    field: "deadline".into(),
                })
            })
        });
        let deadline_ns = asked.transpose()?.unwrap_or(1_000_000_000).clamp(1, left.max(1));
        let arg = match r.json {
            Some(value) => Payload::Json(convert::from_value(value)),
            None if r.encoded.is_empty() => Payload::None,
            None => Payload::Encoded(r.encoded),
        };
        let lcm = self.lcm(&member.port.component.process).map_err(refuse)?;
        let call = Invoke { member: member.clone(), arg, send: r.send, deadline_ns };
        // The LCM keeps the deadline itself; this is for one that does not answer at all.
        let patience = Duration::from_nanos(deadline_ns) + Duration::from_millis(500);
        let reply = tokio::time::timeout(patience, lcm.invoke(call))
            .await
            .map_err(|_| refuse(Refusal::Deadline { member, after_ns: deadline_ns, may_still_run: true }))?
            .map_err(refuse)?;
        Ok(Response::new(v1::InvokeResponse {
            executed: reply.executed,
            json: reply.value.as_ref().map(convert::to_value),
            encoded: reply.encoded,
            unit: reply.unit,
            stamp_ns: reply.stamp_ns,
            age_ns: reply.age_ns,
        }))
    }

    async fn read(&self, request: Request<v1::ReadRequest>) -> Result<Response<v1::ReadResponse>, Status> {
        let until = deadline(&request).min(Instant::now() + Duration::from_secs(2));
        let path = request.into_inner().path;
        let lcm = self.lcm(&process_of(&path).map_err(refuse)?).map_err(refuse)?;
        let sample = lcm.read(path, until).await.map_err(refuse)?;
        Ok(Response::new(v1::ReadResponse {
            json: Some(convert::to_value(&sample.value)),
            encoded: sample.encoded,
            stamp_ns: sample.stamp_ns,
            age_ns: sample.age_ns,
            seq: sample.seq,
            frame_bytes: sample.frame_bytes,
        }))
    }

    async fn emit(&self, _: Request<v1::EmitRequest>) -> Result<Response<v1::EmitResponse>, Status> {
        Err(not_built("Emit", "invoke a command of the component that generates the event"))
    }

    type SubscribeStream = Items;

    async fn subscribe(&self, request: Request<v1::SubscribeRequest>) -> Result<Response<Items>, Status> {
        let selections = request.into_inner().selections;
        if selections.is_empty() {
            return Err(refuse(Refusal::ArgumentInvalid {
                what: "Subscribe".into(),
                why: "nothing is selected: give selections such as [{\"path\": \"host/robot/arm/operating_state\"}]"
                    .into(),
                field: "selections".into(),
            }));
        }
        let (tell, told) = mpsc::channel(WAITING);
        let mut feeds = Vec::new();
        for s in selections {
            let lcm = self.lcm(&process_of(&s.path).map_err(refuse)?).map_err(refuse)?;
            let selection = Selection { path: s.path, max_rate_hz: s.max_rate_hz };
            feeds.push(lcm.subscribe(vec![selection]).await.map_err(refuse)?);
        }
        for mut feed in feeds {
            let tell = tell.clone();
            tokio::spawn(async move {
                loop {
                    let item = tokio::select! {
                        () = tell.closed() => return,
                        item = feed.recv() => item,
                    };
                    // A slow caller fills this channel; the LCM then drops and counts.
                    let Some(item) = item else { return };
                    if tell.send(Ok(convert_item(item))).await.is_err() {
                        return;
                    }
                }
            });
        }
        Ok(Response::new(Box::pin(ReceiverStream::new(told))))
    }

    type LogsStream = Lines;

    async fn logs(&self, request: Request<v1::LogsRequest>) -> Result<Response<Lines>, Status> {
        let r = request.into_inner();
        let level = level_number(&r.level).ok_or_else(|| {
            refuse(Refusal::ArgumentInvalid {
                what: format!("level \"{}\"", r.level),
                why: "it is not one of error, warn, info, debug, trace".into(),
                field: "level".into(),
            })
        })?;
        let (tell, told) = mpsc::channel(WAITING);
        let wanted = r.path.trim_end_matches("**").trim_end_matches('/').to_owned();
        for process in self.processes() {
            let Ok(lcm) = self.lcm(&process) else { continue };
            tokio::spawn(forward_logs(lcm.news(), wanted.clone(), level, tell.clone()));
        }
        Ok(Response::new(Box::pin(ReceiverStream::new(told).map(Ok))))
    }
}

async fn forward_logs(
    mut news: broadcast::Receiver<News>,
    wanted: String,
    level: u32,
    tell: mpsc::Sender<v1::LogsResponse>,
) {
    let mut skipped = 0;
    loop {
        let heard = tokio::select! {
            () = tell.closed() => return,
            heard = news.recv() => heard,
        };
        match heard {
            Ok(News::Log(line)) if line.level <= level && line.path.starts_with(&wanted) => {
                let response = v1::LogsResponse { line: Some(convert_line(line)), skipped };
                skipped = 0;
                if tell.send(response).await.is_err() {
                    return;
                }
            }
            Ok(_) => {}
            Err(broadcast::error::RecvError::Lagged(n)) => skipped += n,
            Err(broadcast::error::RecvError::Closed) => return,
        }
    }
}

const LEVELS: [&str; 5] = ["error", "warn", "info", "debug", "trace"];

/// 1 error … 5 trace; nothing said is info.
fn level_number(text: &str) -> Option<u32> {
    if text.is_empty() {
        return Some(3);
    }
    LEVELS.iter().position(|l| text.eq_ignore_ascii_case(l)).map(|i| i as u32 + 1)
}

pub(crate) fn convert_line(line: LogLine) -> v1::LogLine {
    v1::LogLine {
        wall_ns: line.wall_ns,
        level: LEVELS[(line.level.clamp(1, 5) - 1) as usize].into(),
        path: line.path,
        target: line.target,
        message: line.message,
    }
}

pub(crate) fn convert_item(item: Item) -> v1::SubscribeResponse {
    let kind = match item.kind {
        ItemKind::State => v1::ItemKind::State,
        ItemKind::Event => v1::ItemKind::Event,
        ItemKind::Stream => v1::ItemKind::Stream,
    };
    v1::SubscribeResponse {
        path: item.path,
        kind: kind as i32,
        json: Some(convert::to_value(&item.value)),
        stamp_ns: item.stamp_ns,
        seq: item.seq,
        skipped: item.skipped,
    }
}
