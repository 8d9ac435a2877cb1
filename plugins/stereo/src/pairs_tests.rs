//! Tests of the pair loader on the repository's chessboards and on folders made here.
//!
//! Invariant: each test has its own folder, gone when it ends.
#![allow(clippy::unwrap_used)]

use super::*;
use tempfile::TempDir;

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn grey(dir: &TempDir, name: &str, width: u32, height: u32, level: u8) {
    image::GrayImage::from_pixel(width, height, image::Luma([level])).save(dir.path().join(name)).unwrap();
}

fn refused(dir: &TempDir) -> LoadError {
    Pairs::load(dir.path(), Want::AsStored).expect_err("this folder is bad")
}

#[test]
fn the_thirteen_chessboard_pairs_load_in_order_as_they_are_stored() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/chessboard");
    let loaded = Pairs::load(&folder, Want::AsStored).unwrap();
    assert_eq!((loaded.width, loaded.height, loaded.format), (640, 480, Format::Gray8));
    let names: Vec<_> = loaded.pairs.iter().map(|pair| pair.name.as_str()).collect();
    assert_eq!(names, ["01", "02", "03", "04", "05", "06", "07", "08", "09", "11", "12", "13", "14"]);
    for pair in &loaded.pairs {
        assert_eq!(pair.bytes.len(), 2 * 640 * 480);
        let (left, right) = pair.bytes.split_at(640 * 480);
        assert_ne!(left, right, "pair {} holds one picture twice", pair.name);
    }
}

#[test]
fn numbers_order_by_value_and_before_words() {
    let dir = folder();
    for name in ["10", "9", "b", "2", ""] {
        grey(&dir, &format!("left{name}.png"), 2, 2, 1);
        grey(&dir, &format!("right{name}.png"), 2, 2, 2);
    }
    let loaded = Pairs::load(dir.path(), Want::AsStored).unwrap();
    let names: Vec<_> = loaded.pairs.iter().map(|pair| pair.name.as_str()).collect();
    assert_eq!(names, ["2", "9", "10", "", "b"]);
}

#[test]
fn left_comes_before_right_and_grey_becomes_colour_when_asked() {
    let dir = folder();
    grey(&dir, "left1.png", 2, 1, 10);
    grey(&dir, "right1.PNG", 2, 1, 20);
    let loaded = Pairs::load(dir.path(), Want::AsStored).unwrap();
    assert_eq!(*loaded.pairs[0].bytes, [10, 10, 20, 20]);
    let loaded = Pairs::load(dir.path(), Want::Rgb8).unwrap();
    assert_eq!(*loaded.pairs[0].bytes, [10, 10, 10, 10, 10, 10, 20, 20, 20, 20, 20, 20]);
}

#[test]
fn one_coloured_file_makes_the_whole_folder_coloured() {
    let dir = folder();
    grey(&dir, "left1.png", 1, 1, 10);
    image::RgbImage::from_pixel(1, 1, image::Rgb([1, 2, 3])).save(dir.path().join("right1.png")).unwrap();
    let loaded = Pairs::load(dir.path(), Want::AsStored).unwrap();
    assert_eq!(loaded.format, Format::Rgb8);
    assert_eq!(*loaded.pairs[0].bytes, [10, 10, 10, 1, 2, 3]);
}

#[test]
fn a_missing_folder_is_named() {
    let dir = folder();
    let gone = dir.path().join("nothing/here");
    let why = Pairs::load(&gone, Want::AsStored).expect_err("missing").to_string();
    assert!(why.starts_with(&format!("{}: cannot list this folder", gone.display())), "{why}");
}

#[test]
fn a_folder_without_pairs_says_what_it_looked_for() {
    let dir = folder();
    std::fs::write(dir.path().join("left_intrinsics.yml"), "k: 1").unwrap();
    assert_eq!(refused(&dir), LoadError::NoPairs { folder: dir.path().into(), others: 1 });
    assert!(refused(&dir).to_string().contains("name left1.png, right1.png"));
}

#[test]
fn a_file_without_partner_is_named_with_the_partner_it_lacks() {
    for (there, missing) in [("left3.png", "right3.png"), ("right3.png", "left3.png")] {
        let dir = folder();
        grey(&dir, "left1.png", 1, 1, 0);
        grey(&dir, "right1.png", 1, 1, 0);
        grey(&dir, there, 1, 1, 0);
        assert_eq!(
            refused(&dir),
            LoadError::Unpaired { path: dir.path().join(there), missing: missing.into() }
        );
    }
}

#[test]
fn a_picture_of_another_size_is_named_with_both_sizes() {
    let dir = folder();
    grey(&dir, "left1.png", 4, 3, 0);
    grey(&dir, "right1.png", 4, 2, 0);
    let path = dir.path().join("right1.png");
    assert_eq!(refused(&dir), LoadError::Size { path, got: (4, 2), first: (4, 3) });
}

#[test]
fn a_file_that_is_no_picture_is_named_with_the_decoders_reason() {
    let whole = folder();
    grey(&whole, "left1.png", 40, 30, 0);
    let png = std::fs::read(whole.path().join("left1.png")).unwrap();
    for bytes in [&b"not a picture at all"[..], &b""[..], &png[..png.len() / 2]] {
        let dir = folder();
        grey(&dir, "left1.png", 40, 30, 0);
        std::fs::write(dir.path().join("right1.png"), bytes).unwrap();
        let why = refused(&dir);
        assert!(matches!(&why, LoadError::Unreadable { path, .. } if path.ends_with("right1.png")), "{why}");
    }
}

#[test]
fn the_same_side_twice_is_refused() {
    let dir = folder();
    grey(&dir, "left1.png", 1, 1, 0);
    grey(&dir, "left1.jpg", 1, 1, 0);
    grey(&dir, "right1.png", 1, 1, 0);
    assert!(matches!(refused(&dir), LoadError::Twice { .. }), "{}", refused(&dir));
}
