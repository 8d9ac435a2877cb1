//! Parts that the tests of links between processes lay out: a mailbox with its replies and bell, a stream of
//! samples and one of frames.

use std::sync::Arc;

use trocar_rt::mailbox::Mailbox;
use trocar_rt::region::Layout;
use trocar_rt::reply::ReplyPool;
use trocar_rt::stream::{
    DropPolicy, Payload, Queue, RemotePools, RemoteViews, StreamReader, StreamWriter, remote_reader,
    remote_writer,
};
use trocar_rt::wake::Waker;

pub(crate) const FIFO: Queue = Queue::Fifo { depth: 4, drop: DropPolicy::DropOldest };
pub(crate) const KEEPS_OLD: Queue = Queue::Fifo { depth: 4, drop: DropPolicy::DropNewest };
pub(crate) const QUEUES: [Queue; 3] = [Queue::Latest, FIFO, KEEPS_OLD];

const PLAIN: Payload = Payload::Plain { bytes: 24 };

fn calls(layout: &mut Layout) -> (Mailbox, Arc<ReplyPool>, Waker) {
    (Mailbox::lay_out(layout, 4, 24, 2), ReplyPool::lay_out(layout, 2, 8, 32), Waker::lay_out(layout))
}

/// The end that writes samples and frames.
pub(crate) fn writing(
    layout: &mut Layout,
    queue: Queue,
    pools: &Arc<RemotePools>,
) -> (Mailbox, Arc<ReplyPool>, Waker, StreamWriter, StreamWriter) {
    let (mail, replies, bell) = calls(layout);
    let plain = remote_writer(layout, PLAIN, queue, pools);
    (mail, replies, bell, plain, remote_writer(layout, Payload::Frame, queue, pools))
}

/// The end that reads them.
pub(crate) fn reading(
    layout: &mut Layout,
    queue: Queue,
    views: &Arc<RemoteViews>,
) -> (Mailbox, Arc<ReplyPool>, Waker, StreamReader, StreamReader) {
    let (mail, replies, bell) = calls(layout);
    let plain = remote_reader(layout, PLAIN, queue, views);
    (mail, replies, bell, plain, remote_reader(layout, Payload::Frame, queue, views))
}
