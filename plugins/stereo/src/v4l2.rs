//! A camera of this machine, through Video4Linux.
//!
//! Invariant: what the driver gives is what was configured, or the camera is not taken: no size or format is
//! changed silently. The driver is never waited for but in `poll`.

use std::io::Cursor;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use image::codecs::jpeg::JpegDecoder;
use image::{ColorType, ImageDecoder};
use linuxvideo::format::{PixFormat, PixelFormat as FourCc};
use linuxvideo::stream::ReadStream;
use linuxvideo::{BufType, CapabilityFlags, Device, Fract};
use trocar_sdk::data::PixelFormat;

use crate::feed::{Giver, Source, Stop};
use crate::layout::Layout;

/// Which camera, and what of it.
pub(crate) struct V4l2 {
    pub(crate) device: PathBuf,
    pub(crate) layout: Layout,
    /// The camera sends JPEGs; the layout is that of the pixels in them.
    pub(crate) compressed: bool,
    pub(crate) fps: u32,
    /// A camera that gives nothing for so long has stalled.
    pub(crate) stall: Duration,
    /// From exposure to delivery, s.
    pub(crate) delay_s: f64,
}

/// An open camera that streams.
pub(crate) struct Streaming {
    stream: ReadStream,
    /// Bytes from one row to the next, as the driver lays them out.
    stride: usize,
}

impl Source for V4l2 {
    type Session = Streaming;

    fn open(&self) -> Result<Streaming, String> {
        let name = self.device.display();
        let device = Device::open(&self.device).map_err(|why| {
            let what = match rustix::io::Errno::from_io_error(&why) {
                Some(rustix::io::Errno::NOTTY) => "is no video device".to_owned(),
                _ => format!("cannot be opened: {why}"),
            };
            format!("device: {name} {what}; {}", there_is(Path::new("/dev")))
        })?;
        let about =
            device.capabilities().map_err(|why| format!("device: {name} is no video device: {why}"))?;
        let needed = CapabilityFlags::VIDEO_CAPTURE | CapabilityFlags::STREAMING;
        if !about.device_capabilities().contains(needed) {
            let card = about.card();
            return Err(format!(
                "device: {name} ({card}) does not capture video; {}",
                there_is(Path::new("/dev"))
            ));
        }
        let offers = device
            .formats(BufType::VIDEO_CAPTURE)
            .filter_map(|format| Some(format.ok()?.pixel_format().to_string()))
            .collect::<Vec<_>>()
            .join(", ");
        let (width, height) = self.layout.frame_size();
        let wanted =
            if self.compressed { FourCc::from_fourcc(*b"MJPG") } else { four_cc(self.layout.format) };
        let refused = |what: String| {
            format!(
                "device: {name} gives {what}, not {width}×{height} {wanted}; it offers {offers}: configure what it has"
            )
        };
        let camera = device
            .video_capture(PixFormat::new(width, height, wanted))
            .map_err(|why| refused(format!("no such images ({why})")))?;
        let got = camera.format();
        if (got.width(), got.height(), got.pixel_format()) != (width, height, wanted) {
            return Err(refused(format!("{}×{} {}", got.width(), got.height(), got.pixel_format())));
        }
        if self.fps > 0 {
            // A camera without a choice of rates says so, and keeps its own.
            let _ = camera.set_frame_interval(Fract::new(1, self.fps));
        }
        let stride = (got.bytes_per_line() as usize).max(self.layout.stride() as usize);
        let stream = camera
            .into_stream()
            .map_err(|why| format!("device: {name} does not stream: {why}; does another program use it?"))?;
        Ok(Streaming { stream, stride })
    }

    fn pump(&self, mut open: Streaming, giver: &mut Giver, stop: &Stop) -> String {
        let name = self.device.display();
        let row = self.layout.stride() as usize;
        let mut heard = Instant::now();
        loop {
            let left = self.stall.saturating_sub(heard.elapsed());
            if left.is_zero() {
                return format!("{name} stalled: no image for {} s", self.stall.as_secs_f64());
            }
            let [ready, _] = stop.poll(&[open.stream.as_fd()], left);
            if stop.is_set() {
                return String::new();
            }
            if !ready {
                continue;
            }
            let stride = open.stride;
            let taken = open.stream.dequeue(|image| {
                let whole = !image.is_error()
                    && if self.compressed {
                        unpack(&image, self.layout.frame_size(), giver.room())
                    } else {
                        copy_rows(&image, stride, giver.room(), row)
                    };
                if whole {
                    giver.give(self.delay_s);
                }
                Ok(whole)
            });
            match taken {
                Ok(true) => heard = Instant::now(),
                // A torn image is left out, and does not count as a sign of life.
                Ok(false) => {}
                Err(why) => return format!("{name} is gone or failed: {why}"),
            }
        }
    }
}

/// Copies rows of `row` bytes that begin every `stride` bytes; false when not all are there.
fn copy_rows(from: &[u8], stride: usize, to: &mut [u8], row: usize) -> bool {
    let rows = to.len() / row;
    if rows == 0 || from.len() < (rows - 1) * stride + row {
        return false;
    }
    for (to, from) in to.chunks_exact_mut(row).zip(from.chunks(stride)) {
        to.copy_from_slice(&from[..row]);
    }
    true
}

/// Unpacks a JPEG into RGB pixels; false when it is none of that size. Cameras may leave zeros behind it.
fn unpack(jpeg: &[u8], size: (u32, u32), to: &mut [u8]) -> bool {
    let Ok(decoder) = JpegDecoder::new(Cursor::new(jpeg)) else { return false };
    if decoder.dimensions() != size || decoder.color_type() != ColorType::Rgb8 {
        return false;
    }
    decoder.total_bytes() == to.len() as u64 && decoder.read_image(to).is_ok()
}

fn four_cc(format: PixelFormat) -> FourCc {
    FourCc::from_fourcc(match format {
        PixelFormat::GRAY8 => *b"GREY",
        PixelFormat::BGR8 => *b"BGR3",
        PixelFormat::BAYER_RG8 => *b"RGGB",
        PixelFormat::YUYV => *b"YUYV",
        _ => *b"RGB3",
    })
}

/// Which video devices a folder has, as a half sentence.
fn there_is(folder: &Path) -> String {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = files
        .filter(|file| file.file_name().to_string_lossy().starts_with("video"))
        .map(|file| file.path().display().to_string())
        .collect();
    names.sort();
    match names.as_slice() {
        [] => format!("there is no {}/video*: plug a camera in, or use image_source", folder.display()),
        names => format!("there is {}", names.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn camera(device: &Path) -> V4l2 {
        V4l2 {
            device: device.into(),
            layout: Layout::of(64, 48, "yuyv", "mono").unwrap(),
            compressed: false,
            fps: 30,
            stall: Duration::from_secs(1),
            delay_s: 0.0,
        }
    }

    #[test]
    fn a_device_that_is_not_there_is_named_with_those_that_are() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(
            there_is(dir.path()),
            format!("there is no {}/video*: plug a camera in, or use image_source", dir.path().display())
        );
        for name in ["video1", "video0", "null"] {
            std::fs::write(dir.path().join(name), "").unwrap();
        }
        let at = dir.path().display();
        assert_eq!(there_is(dir.path()), format!("there is {at}/video0, {at}/video1"));
        let why = camera(&dir.path().join("video7")).open().err().unwrap();
        assert!(why.starts_with(&format!("device: {at}/video7 cannot be opened: No such file")), "{why}");
    }

    #[test]
    fn a_file_that_is_no_video_device_is_refused() {
        let why = camera(Path::new("/dev/null")).open().err().unwrap();
        assert!(why.starts_with("device: /dev/null is no video device; there is"), "{why}");
    }

    #[test]
    fn rows_are_taken_without_what_the_driver_pads_them_with() {
        let mut to = [0; 4];
        assert!(copy_rows(&[1, 2, 9, 3, 4], 3, &mut to, 2));
        assert_eq!(to, [1, 2, 3, 4]);
        assert!(!copy_rows(&[1, 2, 9, 3], 3, &mut to, 2), "a torn image");
        assert!(!copy_rows(&[], 2, &mut to, 2));
    }

    #[test]
    fn a_compressed_image_becomes_pixels_and_one_that_is_torn_or_of_another_size_is_left_out() {
        let mut jpeg = Vec::new();
        let pixels = image::RgbImage::from_pixel(16, 8, image::Rgb([200, 40, 40]));
        pixels.write_with_encoder(image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 95)).unwrap();
        let whole = jpeg.len();
        jpeg.extend([0; 100]);
        let mut to = vec![0; 3 * 16 * 8];
        assert!(unpack(&jpeg, (16, 8), &mut to));
        assert!(
            to.as_chunks::<3>()
                .0
                .iter()
                .all(|[r, g, b]| r.abs_diff(200) < 6 && g.abs_diff(40) < 6 && b.abs_diff(40) < 6)
        );
        assert!(!unpack(&jpeg, (8, 16), &mut to));
        assert!(!unpack(&jpeg[..whole / 3], (16, 8), &mut to));
        assert!(!unpack(b"no picture", (16, 8), &mut to));
    }
}
