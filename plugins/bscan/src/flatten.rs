//! The component `flatten`: the image of a scan as it looks with the pigment epithelium straight.
//!
//! Invariant: it shows; nobody measures in its images. Columns are moved up and down and are otherwise as
//! they came.

use trocar_sdk::data::{ImageHeader, ImageView, PixelFormat};
use trocar_sdk::prelude::*;

use crate::layer::Layer;
use crate::sending::SLOTS;

#[derive(Config)]
struct FlattenConfig {
    /// Row of the epithelium in the image that goes out
    #[config(live, min = 0, max = 4095, unit = "px", default = 175)]
    layer_row: u32,
    /// Rows of the image that goes out
    #[config(min = 1, max = 4096, unit = "px", default = 305)]
    rows: u32,
    /// Most columns of an image that comes
    #[config(min = 1, max = 4096, unit = "px", default = 1024)]
    max_columns: u32,
    /// Most rows of an image that comes
    #[config(min = 1, max = 4096, unit = "px", default = 512)]
    max_rows: u32,
}

/// Lays the pigment epithelium of an OCT image straight, as clinical instruments do: the way of the tip is no
/// longer seen, and all that stands above the epithelium is: the retina's thickness, the pit, a membrane.
#[derive(Component)]
#[component(name = "flatten", model = "on_signal")]
pub struct Flatten {
    /// Images of scans, GRAY8
    #[input]
    image: In<Frame<ImageHeader>>,
    /// The same images, of `rows` rows; pixels that they did not show are black
    #[output]
    flattened: Out<Frame<ImageHeader>>,
    /// Images since Start that were laid straight.
    #[state]
    flat: u64,
    /// Images since Start in which no epithelium was found: they go out with their first row as the first.
    #[state]
    without: u64,
    /// Images since Start that were none, not GRAY8, or larger than `max_columns` or `max_rows`.
    #[state]
    refused: u64,
    /// Images since Start for which there was no frame.
    #[state]
    left_out: u64,
    #[config]
    cfg: FlattenConfig,
    layer: Layer,
    built: Option<[u32; 3]>,
}

impl Component for Flatten {
    fn configure(&mut self) -> Result {
        let FlattenConfig { layer_row, rows, max_columns, max_rows } = self.cfg;
        if layer_row >= rows {
            return Err(format!(
                "layer_row: {layer_row} is not in an image of {rows} rows: the last one is {}",
                rows - 1
            )
            .into());
        }
        let room = [rows, max_columns, max_rows];
        if self.built == Some(room) {
            return Ok(());
        }
        self.flattened.reserve(rows as usize * max_columns as usize, SLOTS)?;
        self.layer = Layer::new(max_columns as usize, max_rows as usize);
        self.built = Some(room);
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.flat, self.without, self.refused, self.left_out) = (0, 0, 0, 0);
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        while let Some(frame) = self.image.next() {
            let header = *frame.header();
            let image = frame.image().ok().filter(|image| fits(image, &self.cfg));
            let Some(image) = image else {
                self.refused += 1;
                continue;
            };
            let (width, height) = (image.width() as usize, image.height() as usize);
            let traced = self.layer.trace(width, height, image.rows());
            let Ok(mut loan) = self.flattened.loan() else {
                self.left_out += 1;
                continue;
            };
            let size = width * self.cfg.rows as usize;
            let Some(room) = loan.bytes_mut().get_mut(..size) else {
                self.left_out += 1;
                continue;
            };
            let found = traced.iter().any(Option::is_some);
            let layer_row = self.cfg.layer_row as usize;
            lay(&image, traced, layer_row, room);
            *loan.header_mut() = ImageHeader { height: self.cfg.rows, stride: header.width, ..header };
            loan.commit(size, header.stamp);
            *(if found { &mut self.flat } else { &mut self.without }) += 1;
        }
        self.image.release();
        Ok(())
    }
}

/// Can an image be laid straight?
fn fits(image: &ImageView<'_>, cfg: &FlattenConfig) -> bool {
    image.format() == PixelFormat::GRAY8 && image.width() <= cfg.max_columns && image.height() <= cfg.max_rows
}

/// Moves the columns of `image` so that their rows `traced` are `layer_row`.
fn lay(image: &ImageView<'_>, traced: &[Option<u16>], layer_row: usize, to: &mut [u8]) {
    let height = image.height() as usize;
    for (y, row) in to.chunks_exact_mut(image.width() as usize).enumerate() {
        for ((x, grey), traced) in row.iter_mut().enumerate().zip(traced) {
            let from = match traced {
                Some(traced) => (y + usize::from(*traced)).checked_sub(layer_row),
                None => Some(y),
            };
            *grey = from.filter(|from| *from < height).map_or(0, |from| image.row(from as u32)[x]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_sdk::testing::Bench;

    const ROWS: usize = 60;

    /// An image of columns with a border at the rows given, over tissue; 0 for a black column.
    fn image(borders: &[usize]) -> (ImageHeader, Vec<u8>) {
        let width = borders.len() as u32;
        let grey = |row: usize, border: usize| match (border, row.abs_diff(border)) {
            (0, _) => 0,
            (_, 0) => 200,
            (_, 1) => 120,
            _ => 20,
        };
        let pixels = (0..ROWS).flat_map(|row| borders.iter().map(move |border| grey(row, *border))).collect();
        let stamp = Stamp::from_ns(5);
        let format = PixelFormat::GRAY8;
        (ImageHeader { stamp, index: 3, width, height: ROWS as u32, stride: width, format }, pixels)
    }

    fn bench() -> Bench<Flatten> {
        Bench::new(r#"{"rows": 30, "layer_row": 12, "max_columns": 64, "max_rows": 60}"#)
    }

    #[test]
    fn the_border_is_one_row_whatever_the_tip_did() {
        let mut bench = bench();
        let borders: Vec<usize> = (0..60).map(|x| 25 + x / 6).collect();
        let (header, pixels) = image(&borders);
        bench.push_frame("image", header, &pixels);
        bench.assert_no_alloc(|bench| bench.step(1));
        let (out, flat, stamp) = bench.frames::<ImageHeader>("flattened").pop().unwrap();
        assert_eq!((out, stamp), (ImageHeader { height: 30, ..header }, header.stamp));
        for x in 0..60 {
            let brightest = (0..30).max_by_key(|row| flat[row * 60 + x]).unwrap();
            assert!(brightest.abs_diff(12) <= 1, "column {x}: row {brightest}");
        }
        assert_eq!((bench.state().flat, bench.state().without), (1, 0));
    }

    #[test]
    fn an_image_without_a_border_goes_out_as_it_came_and_is_counted() {
        let mut bench = bench();
        let (header, mut pixels) = image(&[0; 10]);
        pixels.fill(50);
        bench.push_frame("image", header, &pixels);
        bench.step(1);
        let (_, flat, _) = bench.frames::<ImageHeader>("flattened").pop().unwrap();
        assert_eq!((flat.len(), flat.iter().all(|grey| *grey == 50)), (300, true));
        assert_eq!((bench.state().flat, bench.state().without), (0, 1));
    }

    #[test]
    fn what_is_no_image_or_too_large_is_counted() {
        let mut bench = bench();
        let (header, pixels) = image(&[30; 10]);
        let lies = [
            ImageHeader { format: PixelFormat::RGB8, ..header },
            ImageHeader { height: u32::MAX, ..header },
            ImageHeader { width: 0, ..header },
            ImageHeader { width: 65, height: 1, stride: 65, ..header },
            ImageHeader { width: 1, height: 61, stride: 1, ..header },
        ];
        for lie in lies {
            bench.push_frame("image", lie, &pixels);
            bench.step(1);
        }
        assert_eq!((bench.state().refused, bench.frames::<ImageHeader>("flattened").len()), (5, 0));
    }

    #[test]
    fn a_row_that_is_not_in_the_image_is_refused() {
        let refused = Bench::<Flatten>::created().configure(r#"{"rows": 30, "layer_row": 30}"#).unwrap_err();
        assert!(refused.to_string().contains("the last one is 29"), "{refused}");
    }
}
