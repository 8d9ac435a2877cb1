//! Headers that lie: refused with both sizes, whatever the numbers; a header that is not refused is read
//! without a panic.
#![allow(clippy::unwrap_used)]

use super::*;
use proptest::prelude::*;

fn image(width: u32, height: u32, stride: u32, format: PixelFormat) -> ImageHeader {
    ImageHeader { width, height, stride, format, ..Default::default() }
}

fn refused<T>(done: Result<T, BadFrame>) -> String {
    done.err().map(|e| e.to_string()).unwrap_or_default()
}

#[test]
fn rows_skip_the_gap_between_them_and_the_last_one_needs_none() {
    let bytes: Vec<u8> = (0..14).collect();
    let view = image(2, 2, 8, PixelFormat::RGB8).image(&bytes).unwrap();
    assert_eq!((view.row(0), view.row(1)), (&[0, 1, 2, 3, 4, 5][..], &[8, 9, 10, 11, 12, 13][..]));
    assert_eq!((view.rows().len(), view.rows().next()), (2, Some(view.row(0))));
    assert_eq!(view.pixel(1, 1), [11, 12, 13]);
    assert_eq!(view.bytes(), bytes);
    assert_eq!((view.row(2), view.pixel(2, 0), view.pixel(u32::MAX, u32::MAX)), (&[][..], &[][..], &[][..]));
}

#[test]
fn a_header_that_says_more_than_the_bytes_hold_is_refused_with_both_sizes() {
    let max = u32::MAX;
    for (header, bytes, why) in [
        (
            image(640, 480, 1920, PixelFormat::RGB8),
            921_599,
            "a 640 × 480 RGB8 image with a stride of 1920 B needs 921600 B, and the frame has 921599 B",
        ),
        (image(2, 2, 5, PixelFormat::RGB8), 99, "a stride of 5 B is less than a row of 2 RGB8 pixels, 6 B"),
        (image(2, 2, 2, PixelFormat(99)), 99, "99 is no pixel format"),
        (image(0, 2, 2, PixelFormat::GRAY8), 99, "an image of 0 × 2 has no pixels"),
        (image(2, 0, 2, PixelFormat::GRAY8), 0, "an image of 2 × 0 has no pixels"),
        // A product that is small again in 32 bits: 65536 · 65536 = 0.
        (image(65536, 65536, 65536, PixelFormat::GRAY8), 99, "needs 4294967296 B, and the frame has 99 B"),
        (
            image(max, max, max, PixelFormat::RGBA8),
            99,
            "less than a row of 4294967295 RGBA8 pixels, 17179869180 B",
        ),
        (image(1, max, max, PixelFormat::RGBA8), 99, "needs 18446744060824649734 B"),
    ] {
        let said = refused(header.image(&vec![0; bytes]));
        assert!(said.contains(why), "{why:?} is not in: {said}");
    }
    assert!(image(640, 480, 1920, PixelFormat::RGB8).image(&vec![0; 921_600]).is_ok());
}

#[test]
fn one_image_is_a_pair_of_the_same_image() {
    let one = image(2, 1, 2, PixelFormat::GRAY8);
    let [left, right] = StereoHeader::from(one).images(&[3, 4]).unwrap();
    assert_eq!((left.row(0), right.row(0)), (&[3, 4][..], &[3, 4][..]));
    assert_eq!(StereoHeader::from(ImageHeader { index: 7, ..one }).index, 7);
}

#[test]
fn the_right_image_must_lie_in_the_bytes_too() {
    let pair = |right_offset| StereoHeader {
        width: 2,
        height: 2,
        stride: 2,
        format: PixelFormat::GRAY8,
        right_offset,
        ..Default::default()
    };
    let bytes: Vec<u8> = (0..8).collect();
    let [left, right] = pair(4).images(&bytes).unwrap();
    assert_eq!((left.row(1), right.row(1)), (&[2, 3][..], &[6, 7][..]));
    assert_eq!(
        refused(pair(5).images(&bytes)),
        "a 2 × 2 GRAY8 image with a stride of 2 B from byte 5 on needs 9 B, and the frame has 8 B"
    );
    assert!(refused(pair(u64::MAX).images(&bytes)).contains("needs 18446744073709551619 B"));
}

#[test]
fn lines_that_are_not_all_there_are_refused_with_both_sizes() {
    let spectra = |lines, samples, format| SpectraHeader { lines, samples, format, ..Default::default() };
    let bytes: Vec<u8> = (0..12).collect();
    let view = spectra(2, 3, SampleFormat::U16).lines_in(&bytes).unwrap();
    assert_eq!((view.len(), view.line(1), view.line(2)), (2, &bytes[6..], &[][..]));
    assert_eq!(view.iter().count(), 2);
    assert_eq!(
        refused(spectra(2, 4, SampleFormat::U16).lines_in(&bytes)),
        "2 lines of 4 U16 need 16 B, and the frame has 12 B"
    );
    assert!(
        refused(spectra(u32::MAX, u32::MAX, SampleFormat::F32).lines_in(&bytes))
            .contains("need 73786976260478468100 B")
    );
    assert_eq!(
        refused(spectra(u32::MAX, 0, SampleFormat::U8).lines_in(&bytes)),
        "4294967295 lines have no samples in them"
    );
    assert!(spectra(0, 9, SampleFormat::U8).lines_in(&[]).is_ok());
    assert!(refused(spectra(1, 1, SampleFormat(7)).lines_in(&bytes)).contains("7 is no format"));
    let scan =
        AScanHeader { lines: 1 << 16, samples: 1 << 16, format: SampleFormat::U8, ..Default::default() };
    assert!(refused(scan.lines_in(&bytes)).contains("need 4294967296 B"));
}

fn any_size() -> impl Strategy<Value = u32> {
    prop_oneof![0..6u32, any::<u32>(), u32::MAX - 3..=u32::MAX]
}

proptest! {
    #[test]
    fn whatever_a_header_says_reading_stays_inside(
        (width, height, stride) in (any_size(), any_size(), any_size()),
        (format, right_offset) in (0..7u32, prop_oneof![0..40u64, any::<u64>(), u64::MAX - 3..=u64::MAX]),
        (lines, samples) in (any_size(), any_size()),
        bytes in prop::collection::vec(any::<u8>(), 0..64),
        (x, y) in (any::<u32>(), any::<u32>()),
    ) {
        let format = PixelFormat(format);
        let header = StereoHeader { width, height, stride, format, right_offset, ..Default::default() };
        for image in header.images(&bytes).into_iter().flatten() {
            let row = width as usize * format.bytes_per_pixel();
            prop_assert!(image.rows().all(|r| r.len() == row && row > 0));
            prop_assert_eq!(image.rows().len(), height as usize);
            prop_assert_eq!(image.pixel(x, y).is_empty(), x >= width || y >= height);
        }
        let spectra = SpectraHeader { lines, samples, format: SampleFormat(format.0), ..Default::default() };
        if let Ok(view) = spectra.lines_in(&bytes) {
            prop_assert_eq!(view.iter().map(<[u8]>::len).sum::<usize>() / spectra.format.bytes(), lines as usize * samples as usize);
            prop_assert!(view.line(y).is_empty() == (y >= lines));
        }
    }
}
