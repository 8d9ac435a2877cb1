//! Copies of frames for a thread that shows them: the newest one, whatever it has time for.
//!
//! Invariant: the step never waits and never allocates: of three buffers one is always its own. What is
//! handed over is whole: a frame whose header lies, or that does not fit, leaves the one before it where it
//! is.

use triple_buffer::{Input, Output, triple_buffer};

use trocar_sdk::data::StereoHeader;

/// A copy of a frame.
#[derive(Clone, Default)]
pub(crate) struct Snapshot {
    pub(crate) header: StereoHeader,
    bytes: Vec<u8>,
    len: usize,
}

impl Snapshot {
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes[..self.len]
    }
}

/// The step's end.
pub(crate) struct Giver(Input<Snapshot>);

/// The thread's end.
pub(crate) struct Taker(Output<Snapshot>);

/// Both ends, for frames of up to `max_bytes`.
pub(crate) fn pair(max_bytes: usize) -> (Giver, Taker) {
    let (input, output) = triple_buffer(&Snapshot { bytes: vec![0; max_bytes], ..Snapshot::default() });
    (Giver(input), Taker(output))
}

impl Giver {
    /// Copies a frame whose header is true and whose bytes fit; tells whether it did.
    pub(crate) fn give(&mut self, header: &StereoHeader, from: &[u8]) -> bool {
        if header.images(from).is_err() || from.len() > self.0.input_buffer_mut().bytes.len() {
            return false;
        }
        let copy = self.0.input_buffer_mut();
        copy.bytes[..from.len()].copy_from_slice(from);
        (copy.header, copy.len) = (*header, from.len());
        self.0.publish();
        true
    }
}

impl Taker {
    /// Looks for a newer copy; tells whether there is one.
    pub(crate) fn renew(&mut self) -> bool {
        self.0.update()
    }

    /// The newest copy of the last look; without an image before the first one.
    pub(crate) fn newest(&self) -> &Snapshot {
        self.0.output_buffer()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_sdk::data::PixelFormat;

    #[test]
    fn the_newest_whole_frame_arrives_and_stays() {
        let (mut giver, mut taker) = pair(4);
        let header =
            StereoHeader { width: 2, height: 1, stride: 2, format: PixelFormat::GRAY8, ..Default::default() };
        assert!(!taker.renew() && taker.newest().bytes().is_empty());
        for level in 1..=20 {
            assert!(giver.give(&header, &[level; 2]));
        }
        assert!(taker.renew() && !taker.renew());
        assert_eq!(taker.newest().bytes(), [20; 2]);
        assert!(!giver.give(&StereoHeader { width: 3, ..header }, &[9; 2]), "its header lies");
        assert!(!giver.give(&header, &[9; 5]), "it is too large");
        assert!(!taker.renew());
        assert_eq!((taker.newest().bytes(), taker.newest().header.width), (&[20; 2][..], 2));
    }
}
