//! Video as QOI, which loses nothing, or as JPEG, in the writer's thread.
//!
//! Invariant: pixels that cannot be compressed are told, never written as something else.

use jpeg_encoder::{ColorType, Encoder};

use crate::block::Kind;
use crate::foxglove;
use crate::orders::Codec;

/// Whether images of this encoding can be kept so.
pub(crate) fn takes(codec: Codec, encoding: &str) -> bool {
    match codec {
        Codec::Raw => false,
        Codec::Qoi => matches!(encoding, "rgb8" | "rgba8" | "bgr8"),
        Codec::Jpeg(_) => matches!(encoding, "mono8" | "rgb8" | "rgba8" | "bgr8"),
    }
}

/// Appends pixels as a `foxglove.CompressedImage`; false where that is not possible.
pub(crate) fn encode(codec: Codec, kind: Kind, stamp_ns: u64, pixels: &[u8], to: &mut Vec<u8>) -> bool {
    let Kind::Pixels { width, height, stride, encoding } = kind else { return false };
    let bytes = match encoding {
        "mono8" => 1,
        "rgba8" => 4,
        _ => 3,
    };
    let row = width as usize * bytes;
    let Some(tight) =
        rows(pixels, row, stride as usize, height as usize, codec == Codec::Qoi && encoding == "bgr8")
    else {
        return false;
    };
    match codec {
        Codec::Raw => false,
        Codec::Qoi => match qoi::encode_to_vec(&tight, width, height) {
            Ok(data) => {
                foxglove::compressed(stamp_ns, "qoi", &data, to);
                true
            }
            Err(_) => false,
        },
        Codec::Jpeg(quality) => {
            let color = match encoding {
                "mono8" => ColorType::Luma,
                "rgba8" => ColorType::Rgba,
                "bgr8" => ColorType::Bgr,
                _ => ColorType::Rgb,
            };
            let (Ok(width), Ok(height)) = (u16::try_from(width), u16::try_from(height)) else { return false };
            let mut data = Vec::with_capacity(tight.len() / 8);
            if Encoder::new(&mut data, quality).encode(&tight, width, height, color).is_err() {
                return false;
            }
            foxglove::compressed(stamp_ns, "jpeg", &data, to);
            true
        }
    }
}

/// Returns the rows without gaps, with red and blue exchanged if asked for.
fn rows(pixels: &[u8], row: usize, stride: usize, height: usize, swap: bool) -> Option<Vec<u8>> {
    if row == 0
        || stride < row
        || pixels.len() < stride.checked_mul(height.checked_sub(1)?)?.checked_add(row)?
    {
        return None;
    }
    let mut tight: Vec<u8> = pixels
        .chunks(stride)
        .take(height)
        .flat_map(|line| line.get(..row).unwrap_or_default())
        .copied()
        .collect();
    if swap {
        tight.chunks_exact_mut(3).for_each(|pixel| pixel.swap(0, 2));
    }
    (tight.len() == row * height).then_some(tight)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(encoding: &'static str, stride: u32) -> Kind {
        Kind::Pixels { width: 5, height: 3, stride, encoding }
    }

    #[test]
    fn qoi_gives_every_pixel_back_and_gaps_between_rows_are_no_pixels() {
        let pixels: Vec<u8> = (0..2 * 17 + 15).map(|n| (n * 7) as u8).collect();
        let mut to = Vec::new();
        assert!(encode(Codec::Qoi, kind("rgb8", 17), 0, &pixels, &mut to));
        let at = to.windows(4).position(|w| w == b"qoif").expect("the file's first word");
        let (_, back) = qoi::decode_to_vec(&to[at..]).expect("an image");
        let tight: Vec<u8> = (0..3).flat_map(|y| pixels[y * 17..y * 17 + 15].to_vec()).collect();
        assert_eq!(back, tight);
    }

    #[test]
    fn pixels_that_are_not_there_or_not_known_are_told() {
        let mut to = Vec::new();
        assert!(!encode(Codec::Qoi, kind("rgb8", 15), 0, &[0; 44], &mut to));
        assert!(!encode(Codec::Jpeg(75), kind("rgb8", 14), 0, &[0; 45], &mut to));
        assert!(!takes(Codec::Qoi, "mono16") && takes(Codec::Jpeg(75), "bgr8"));
        assert!(to.is_empty());
    }
}
