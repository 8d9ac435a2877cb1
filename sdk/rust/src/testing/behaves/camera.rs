//! Behaviour of a camera: the rules of `contracts::CAMERA`, tried on the bench.
//!
//! Invariant: every rule has its check. The bench plays the readers that hold all frames; the camera sends in
//! `step`.

use super::super::bench::{Bench, Life};
use super::super::shape::Of;
use crate::class::Class;
use crate::data::{CameraGeometry, ImageHeader, StereoHeader};
use crate::values::Stamp;
use std::time::{Duration, Instant};
use trocar_plugin_api::contracts::CAMERA;
use trocar_plugin_api::manifest::PortType;

const LEFT_OUT: &str = CAMERA.rules[0];
const SAME_SIZE: &str = CAMERA.rules[1];
const INSIDE: &str = CAMERA.rules[2];
/// Steps within which a camera sends an image, or leaves one out.
const PATIENCE: u32 = 10_000;
/// Time within which a fed camera does that.
const FED: Duration = Duration::from_secs(30);

/// Fails the test, with the broken rule and the last events, unless the camera behind `interface`, with its
/// output `image`, behaves as the contract of cameras says (`docs/INTERFACES.md`). The camera is ACTIVE and
/// sends in `step`; in the end it is ACTIVE again, after a stop and a start.
pub fn assert_behaves_as_camera<C: Class>(bench: &mut Bench<C>, interface: &str) {
    behaves(Camera { bench, interface, dropped: 0, emitted: None, feed: None });
}

/// Checks as [`assert_behaves_as_camera`] does, for a camera whose images come from outside, in their own
/// time: `feed` runs before each step and lets the next image come when the one before was taken. An image
/// may take 30 s of wall-clock time.
pub fn assert_behaves_as_camera_fed<C: Class>(
    bench: &mut Bench<C>,
    interface: &str,
    mut feed: impl FnMut(&mut Bench<C>),
) {
    behaves(Camera { bench, interface, dropped: 0, emitted: None, feed: Some(&mut feed) });
}

fn behaves<C: Class>(mut camera: Camera<'_, C>) {
    const { assert!(CAMERA.rules.len() == 3, "every rule has its check") };
    let live = camera.bench.life() == Life::Active;
    camera.expect(live, CAMERA.threads, || "it is not ACTIVE: give what `Bench::new` made".into());
    camera.takes_what_is_there();
    camera.sends_and_leaves_out();
    // Counts begin anew with a start.
    let again = camera.bench.stop().and_then(|()| camera.bench.start());
    camera.expect(again.is_ok(), CAMERA.threads, || format!("it does not stop and start again: {again:?}"));
    camera.dropped = 0;
    camera.emitted = camera.read_emitted();
    camera
        .expect(camera.emitted.is_none_or(|n| n == 0), LEFT_OUT, || "`emitted` goes on after a start".into());
    camera.sends_and_leaves_out();
}

type Feed<'b, C> = &'b mut dyn FnMut(&mut Bench<C>);

struct Camera<'b, C: Class> {
    bench: &'b mut Bench<C>,
    interface: &'b str,
    /// Told by the last `frame_dropped` since Start.
    dropped: u64,
    /// Last answer of `emitted`; none when it is not offered.
    emitted: Option<u64>,
    /// Feed that lets images come from outside.
    feed: Option<Feed<'b, C>>,
}

/// Limit of the wait for an image, or for the news that one is left out: a number of steps, or a time where
/// images come from outside.
struct Patience {
    looked: Instant,
    waited: Duration,
    steps: u32,
    fed: bool,
}

impl Patience {
    fn is_over(&mut self) -> bool {
        self.steps += 1;
        // A machine that stands still costs no more than a second of the time.
        self.waited += self.looked.elapsed().min(Duration::from_secs(1));
        self.looked = Instant::now();
        if self.fed { self.waited > FED } else { self.steps > PATIENCE }
    }

    fn text(&self) -> String {
        if self.fed { format!("{} s", FED.as_secs()) } else { format!("{PATIENCE} steps") }
    }
}

/// Content that both kinds of header have.
struct Image {
    index: u64,
    stamp: Stamp,
    /// Width, height and format.
    size: (u32, u32, u32),
    /// Part that the header promises and the bytes do not hold.
    beyond: Option<String>,
}

impl<C: Class> Camera<'_, C> {
    /// A camera that has run already may have sent and left out some.
    fn takes_what_is_there(&mut self) {
        self.images();
        self.dropped = self.drops().last().copied().unwrap_or(0);
        self.emitted = self.read_emitted();
    }

    fn sends_and_leaves_out(&mut self) {
        let first = self.next_image();
        let second = self.next_image();
        self.expect(second.index == first.index + 1, LEFT_OUT, || {
            format!("image {} came after image {}, and none was left out", second.index, first.index)
        });
        self.expect(second.stamp > first.stamp, CAMERA.frames, || "its images do not get younger".into());
        let left_out = self.leaves_out(3);
        let third = self.next_image();
        let want = second.index + left_out + 1;
        self.expect(third.index == want, LEFT_OUT, || {
            format!("image {} came where {left_out} were left out after {}", third.index, second.index)
        });
        for image in [&second, &third] {
            self.expect(image.size == first.size, SAME_SIZE, || {
                format!("an image of {:?} came after one of {:?}", image.size, first.size)
            });
        }
    }

    /// Steps without a free frame until so many images are left out; how many are.
    fn leaves_out(&mut self, images: u64) -> u64 {
        self.bench.exhaust("image", true);
        let before = self.dropped;
        let mut patience = self.patience();
        while !patience.is_over() {
            self.step();
            for told in self.drops() {
                self.expect(told == self.dropped + 1, LEFT_OUT, || {
                    format!("`frame_dropped` told {told} after {}", self.dropped)
                });
                self.dropped = told;
            }
            let sent = self.images().len();
            self.expect(sent == 0, LEFT_OUT, || format!("{sent} images were sent without a free frame"));
            if self.dropped >= before + images {
                break;
            }
        }
        self.bench.exhaust("image", false);
        let left_out = self.dropped - before;
        self.expect(left_out >= images, LEFT_OUT, || {
            format!("{} without a free frame, and `frame_dropped` told {left_out} times", patience.text())
        });
        left_out
    }

    /// Steps until an image comes, and checks that it fits its bytes and the camera's own figures.
    fn next_image(&mut self) -> Image {
        let mut patience = self.patience();
        while !patience.is_over() {
            self.step();
            let mut images = self.images();
            let Some(image) = images.pop() else { continue };
            self.expect(images.is_empty(), CAMERA.threads, || "one step sent several images".into());
            let drops = self.drops();
            self.expect(drops.is_empty(), LEFT_OUT, || format!("`frame_dropped` told {drops:?} of no loss"));
            self.fits(&image);
            return image;
        }
        self.breaks(CAMERA.threads, &format!("no image came in {}", patience.text()))
    }

    fn fits(&mut self, image: &Image) {
        self.expect(image.beyond.is_none(), INSIDE, || image.beyond.clone().unwrap_or_default());
        self.expect(image.stamp.is_valid(), CAMERA.frames, || "an image has no stamp".into());
        let says: CameraGeometry = match self.bench.read(&format!("{}/camera_geometry", self.interface), ()) {
            Ok(says) => says,
            Err(why) => self.breaks(CAMERA.threads, &format!("camera_geometry is refused: {why}")),
        };
        let (width, height, _) = image.size;
        self.expect((says.width, says.height) == (width, height), SAME_SIZE, || {
            format!("camera_geometry says {} × {}, an image has {width} × {height}", says.width, says.height)
        });
        let now = self.read_emitted();
        if let (Some(now), Some(before)) = (now, self.emitted) {
            self.expect(now == before + 1, LEFT_OUT, || {
                format!("`emitted` went from {before} to {now} by one image")
            });
        }
        self.emitted = now;
    }

    fn patience(&self) -> Patience {
        Patience { looked: Instant::now(), waited: Duration::ZERO, steps: 0, fed: self.feed.is_some() }
    }

    fn step(&mut self) {
        if let Some(feed) = &mut self.feed {
            feed(self.bench);
        }
        let done = self.bench.try_step();
        self.expect(done.is_ok(), CAMERA.threads, || format!("its step failed: {done:?}"));
    }

    fn drops(&mut self) -> Vec<u64> {
        self.bench.events(&format!("{}/frame_dropped", self.interface))
    }

    fn read_emitted(&self) -> Option<u64> {
        let path = format!("{}/emitted", self.interface);
        let offered = self.bench.shape.members(Of::Commands).iter().any(|m| m.path == path);
        offered.then(|| self.bench.read(&path, ()).unwrap_or_default())
    }

    /// Returns the images sent since the last call.
    fn images(&mut self) -> Vec<Image> {
        let at = self.bench.shape.output("image");
        let stereo = matches!(&self.bench.shape.class().outputs[at].ty,
            PortType::Frame { format, .. } if format == "stereo");
        if stereo {
            let frames = self.bench.frames::<StereoHeader>("image");
            return frames.into_iter().map(|(h, bytes, _)| stereo_image(&h, &bytes)).collect();
        }
        let frames = self.bench.frames::<ImageHeader>("image");
        frames.into_iter().map(|(h, bytes, _)| one_image(&h, &bytes)).collect()
    }

    fn expect(&self, holds: bool, rule: &str, what: impl FnOnce() -> String) {
        if !holds {
            self.breaks(rule, &what());
        }
    }

    fn breaks(&self, rule: &str, what: &str) -> ! {
        let history = self.bench.history.text(&self.bench.shape);
        let interface = self.interface;
        panic!(
            "`{interface}` does not behave as a camera: {what}\nthe rule (docs/INTERFACES.md): {rule}{history}"
        )
    }
}

fn one_image(h: &ImageHeader, bytes: &[u8]) -> Image {
    let beyond = h.image(bytes).err().map(|why| why.to_string());
    Image { index: h.index, stamp: h.stamp, size: (h.width, h.height, h.format.0), beyond }
}

fn stereo_image(h: &StereoHeader, bytes: &[u8]) -> Image {
    let beyond = h.images(bytes).err().map(|why| why.to_string());
    Image { index: h.index, stamp: h.stamp, size: (h.width, h.height, h.format.0), beyond }
}
