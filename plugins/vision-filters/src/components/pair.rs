//! Stereo frames as views: both images of a received frame, both images of a frame to be filled, and the
//! count of both.
//!
//! Invariant: header fields come from a peer and are believed only after `View` has checked them against the
//! bytes.

use trocar_sdk::data::{BadFrame, ImageView, PixelFormat, StereoHeader};
use trocar_sdk::prelude::*;
use trocar_sdk::{FrameLoan, FrameView};

use crate::view::{Format, Shape, View, ViewMut};

/// Why a frame was left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unfit {
    /// A pixel format that the filters do not know.
    Format,
    /// The header promises more bytes than there are.
    Short,
    /// The result is larger than the output's frames.
    Large,
    /// Wider or higher than can be resized.
    Side,
    /// An inset with more pixels than can be brought to another size.
    Inset,
    /// No frame to fill.
    NoRoom,
    /// Not what the calibration was made with.
    Calibration,
    /// A format without a colour filter.
    NotBayer,
    /// Too small to hold the pattern of a colour filter.
    NoPattern,
    /// A format that is no picture.
    NoWay,
    /// A part that reaches beyond the image.
    Part,
    /// Images that lie in each other.
    Overlap,
}

impl Unfit {
    fn sentence(self) -> &'static str {
        match self {
            Unfit::Format => "pixel format is not GRAY8 or RGB8: convert it at the source",
            Unfit::Short => "size, stride or right_offset do not fit the bytes: repair the source",
            Unfit::Large => "larger than max_width x max_height: configure larger ones",
            Unfit::Calibration => "not the size the calibration was made with: calibrate at this size",
            Unfit::NotBayer => "pixel format is not BAYER_RG8, RGB8 or GRAY8: convert it at the source",
            Unfit::NoPattern => "an image with a colour filter has at least 2 x 2 px: repair the source",
            Unfit::NoWay => "pixel format is not GRAY8, RGB8, BGR8, RGBA8 or YUYV: convert it at the source",
            Unfit::Part => "x + width or y + height is beyond the image: configure a part that lies in it",
            Unfit::Side => "a side of more than 16384 px: crop it before",
            Unfit::Inset => {
                "too large to be scaled: ask for w and h of at most max_width and max_height, none of them 0"
            }
            Unfit::Overlap => "right_offset lies in the left image: repair the source",
            Unfit::NoRoom => "all frames of the output are held by readers: let fewer or faster ones read",
        }
    }
}

impl From<NoFrame> for Unfit {
    fn from(_: NoFrame) -> Unfit {
        Unfit::NoRoom
    }
}

impl From<BadFrame> for Unfit {
    fn from(why: BadFrame) -> Unfit {
        match why {
            BadFrame::PixelFormat { .. } => Unfit::Format,
            _ => Unfit::Short,
        }
    }
}

/// Counts of the frames of a filter.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Tally {
    /// Frames handled.
    pub frames: u64,
    /// Frames left out.
    pub rejected: u64,
    /// Why the last one was left out; empty when none was.
    pub problem: Text<96>,
}

impl Tally {
    pub(super) fn count(&mut self, done: Result<(), Unfit>) {
        match done {
            Ok(()) => self.frames += 1,
            Err(why) => {
                self.rejected += 1;
                self.problem = Text::new(why.sentence());
            }
        }
    }
}

/// Lets `filter` take the frames that wait, a burst at most, and counts what became of them.
pub(super) fn each(
    from: &mut In<Frame<StereoHeader>>,
    tally: &mut Tally,
    mut filter: impl FnMut(FrameView<'_, StereoHeader>) -> Result<(), Unfit>,
) {
    for _ in 0..super::BURST {
        let Some(frame) = from.next() else { break };
        tally.count(filter(frame));
    }
}

/// The pool that holds frames of two packed images of `shape`, made once per size.
pub(super) fn reserve(out: &mut Out<Frame<StereoHeader>>, made: &mut usize, shape: Shape) -> Result {
    let bytes = 2 * shape.packed_bytes();
    if *made != bytes {
        out.reserve(bytes, super::SLOTS)?;
        *made = bytes;
    }
    Ok(())
}

/// Both images of a received frame in any format, left first.
pub(super) fn raw<'a>(frame: &'a FrameView<'_, StereoHeader>) -> Result<[ImageView<'a>; 2], Unfit> {
    Ok(frame.images()?)
}

/// Sends a frame of the same size whose rows are made one by one: `row` makes row `y` of a received image, or
/// says that it cannot.
pub(super) fn convert(
    frame: &FrameView<'_, StereoHeader>,
    out: &mut Out<Frame<StereoHeader>>,
    format: PixelFormat,
    row: impl Fn(&ImageView<'_>, u32, &mut [u8]) -> bool,
) -> Result<(), Unfit> {
    let source = raw(frame)?;
    let layout = if format.bytes_per_pixel() == 1 { Format::Gray8 } else { Format::Rgb8 };
    let (width, height) = (source[0].width() as usize, source[0].height() as usize);
    let shape = Shape { width, height, format: layout };
    let mut loan = out.loan()?;
    let mut images = blank_as(&mut loan, frame.header(), shape, format)?;
    for (from, to) in source.iter().zip(&mut images) {
        for y in 0..from.height() {
            if !row(from, y, to.row_mut(y as usize)) {
                return Err(Unfit::NoWay);
            }
        }
    }
    loan.commit(2 * shape.packed_bytes(), frame.stamp());
    Ok(())
}

/// Passes a frame on as it is, when it is what its header says.
pub(super) fn forward(
    frame: &FrameView<'_, StereoHeader>,
    out: &mut Out<Frame<StereoHeader>>,
) -> Result<(), Unfit> {
    raw(frame)?;
    out.forward(frame);
    Ok(())
}

/// Is this one image for both eyes, or a pair side by side? Their rows cannot be lent apart from each other.
pub(super) fn share_rows(header: &StereoHeader) -> Result<bool, Unfit> {
    let (row, right) = (shape(header)?.row_bytes() as u64, header.right_offset);
    let beside = right >= row && right.checked_add(row).is_some_and(|end| end <= u64::from(header.stride));
    Ok(right == 0 || beside)
}

/// Both images of a frame that may be changed, left first.
pub(super) fn images_mut<'a>(header: &StereoHeader, bytes: &'a mut [u8]) -> Result<[ViewMut<'a>; 2], Unfit> {
    let shape = shape(header)?;
    let right = usize::try_from(header.right_offset).map_err(|_| Unfit::Short)?;
    let (left, right) = bytes.split_at_mut_checked(right).ok_or(Unfit::Short)?;
    let stride = header.stride as usize;
    let right = ViewMut::new(shape, stride, right).map_err(|_| Unfit::Short)?;
    Ok([ViewMut::new(shape, stride, left).map_err(|_| Unfit::Overlap)?, right])
}

/// Both images of a received frame, left first.
pub(super) fn images<'a>(frame: &'a FrameView<'_, StereoHeader>) -> Result<[View<'a>; 2], Unfit> {
    images_in(frame.header(), frame.bytes())
}

/// Both images in the bytes that came with a header, left first.
pub(super) fn images_in<'a>(header: &StereoHeader, bytes: &'a [u8]) -> Result<[View<'a>; 2], Unfit> {
    let [left, right] = header.images(bytes)?.map(View::of);
    left.zip(right).map(|(left, right)| [left, right]).ok_or(Unfit::Format)
}

fn shape(header: &StereoHeader) -> Result<Shape, Unfit> {
    let format = Format::of(header.format).ok_or(Unfit::Format)?;
    Ok(Shape { width: header.width as usize, height: header.height as usize, format })
}

/// Two packed images of `shape` to be filled; the rest of the header is that of `from`.
pub(super) fn blank<'a>(
    loan: &'a mut FrameLoan<'_, StereoHeader>,
    from: &StereoHeader,
    shape: Shape,
) -> Result<[ViewMut<'a>; 2], Unfit> {
    blank_as(loan, from, shape, shape.format.in_header())
}

/// As [`blank`]; the header says `format`, which has as many bytes as the shape's.
pub(super) fn blank_as<'a>(
    loan: &'a mut FrameLoan<'_, StereoHeader>,
    from: &StereoHeader,
    shape: Shape,
    format: PixelFormat,
) -> Result<[ViewMut<'a>; 2], Unfit> {
    *loan.header_mut() = StereoHeader {
        width: shape.width as u32,
        height: shape.height as u32,
        stride: shape.row_bytes() as u32,
        format,
        right_offset: shape.packed_bytes() as u64,
        ..*from
    };
    let (left, right) = loan.bytes_mut().split_at_mut_checked(shape.packed_bytes()).ok_or(Unfit::Large)?;
    let view = |bytes| ViewMut::packed(shape, bytes).map_err(|_| Unfit::Large);
    Ok([view(left)?, view(right)?])
}
