//! A PNG file that was not there before, and why one is not written.
//!
//! Invariant: nothing that exists is ever written over, and a file that could not be written whole does not
//! stay.

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use trocar_sdk::prelude::*;

/// A picture that `save` is asked for.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct SaveRequest {
    /// A new file whose name ends with .png, in a directory that exists; seen from where the host was
    /// started.
    pub path: Text<1024>,
}

/// A picture that `save` has written.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct SavedPicture {
    /// Size of the file.
    #[unit("B")]
    pub bytes: u64,
    /// Age of the newest part of the picture: a picture that stands still is written, too.
    #[unit("s")]
    pub age: f64,
    #[unit("px")]
    pub width: u32,
    #[unit("px")]
    pub height: u32,
}

/// Pixels to be written: red, green, blue of each, row after row.
pub(crate) struct Picture {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) rgb: Vec<u8>,
}

/// Checks how a file is called. Asks no file system: for the thread of the component.
///
/// # Errors
/// The name is empty or does not end with .png.
pub(crate) fn named(path: &str) -> Result<PathBuf> {
    let path = Path::new(path);
    if path.extension().is_none_or(|end| !end.eq_ignore_ascii_case("png")) {
        let path = path.display();
        return Err(format!(
            "path: {path:?} does not end with .png, and PNG is what is written: add the ending"
        )
        .into());
    }
    Ok(path.to_owned())
}

/// Writes a picture to a new file. May wait for a file system: for a thread of its own.
///
/// # Errors
/// There is something of that name, its directory is not there, or the system refuses.
pub(crate) fn write(path: &Path, picture: &Picture) -> Result<SavedPicture, String> {
    let shown = path.display();
    let mut file =
        OpenOptions::new().write(true).create_new(true).open(path).map_err(|why| refused(path, &why))?;
    let written = encode(&file, picture).and_then(|()| file.flush().map_err(|why| why.to_string()));
    match written.and_then(|()| file.metadata().map_err(|why| why.to_string())) {
        Ok(there) => {
            Ok(SavedPicture { bytes: there.len(), age: 0.0, width: picture.width, height: picture.height })
        }
        Err(why) => {
            let _ = std::fs::remove_file(path);
            Err(format!("path: {shown:?} cannot be written whole: {why}; it was removed"))
        }
    }
}

fn encode(file: &File, picture: &Picture) -> Result<(), String> {
    let mut encoder = png::Encoder::new(BufWriter::new(file), picture.width, picture.height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let written = encoder.write_header().and_then(|mut writer| {
        writer.write_image_data(&picture.rgb)?;
        writer.finish()
    });
    written.map_err(|why| why.to_string())
}

fn refused(path: &Path, why: &std::io::Error) -> String {
    let shown = path.display();
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let directory = parent.display();
    match why.kind() {
        ErrorKind::AlreadyExists => {
            format!("path: {shown:?} exists, and nothing is written over: choose another name, or remove it")
        }
        ErrorKind::NotFound if !parent.exists() => {
            format!("path: the directory {directory:?} does not exist: make it first")
        }
        ErrorKind::NotADirectory => {
            format!("path: {directory:?} is no directory: choose one")
        }
        _ => format!("path: {shown:?} cannot be made: {why}; choose a directory that the host may write to"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture() -> Picture {
        Picture { width: 3, height: 2, rgb: (0..18).collect() }
    }

    #[test]
    fn a_written_file_holds_the_pixels_and_is_as_long_as_it_is_said_to_be() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        let saved = write(&path, &picture()).unwrap();
        assert_eq!(
            saved,
            SavedPicture { bytes: path.metadata().unwrap().len(), age: 0.0, width: 3, height: 2 }
        );
        let mut reader =
            png::Decoder::new(std::io::BufReader::new(File::open(&path).unwrap())).read_info().unwrap();
        let mut pixels = vec![0; 18];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height, info.color_type), (3, 2, png::ColorType::Rgb));
        assert_eq!(pixels, picture().rgb);
    }

    #[test]
    fn what_exists_is_left_as_it_is() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        std::fs::write(&path, "precious").unwrap();
        let why = write(&path, &picture()).unwrap_err();
        assert!(why.contains("exists, and nothing is written over"), "{why}");
        assert_eq!(std::fs::read(&path).unwrap(), b"precious");
        // A link to nowhere is something that exists, too.
        let link = dir.path().join("b.png");
        std::os::unix::fs::symlink(dir.path().join("elsewhere"), &link).unwrap();
        assert!(write(&link, &picture()).is_err());
        assert!(!dir.path().join("elsewhere").exists());
    }

    #[test]
    fn a_missing_directory_and_a_file_in_its_place_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let why = write(&dir.path().join("none/a.png"), &picture()).unwrap_err();
        assert!(why.contains("none\" does not exist: make it first"), "{why}");
        std::fs::write(dir.path().join("file"), "").unwrap();
        let why = write(&dir.path().join("file/a.png"), &picture()).unwrap_err();
        assert!(why.contains("file\" is no directory"), "{why}");
        let why = write(Path::new("/proc/a.png"), &picture()).unwrap_err();
        assert!(why.contains("cannot be made"), "{why}");
        let why = write(Path::new("a\0b.png"), &picture()).unwrap_err();
        assert!(why.contains("cannot be made"), "{why}");
    }

    #[test]
    fn a_file_that_cannot_be_written_whole_does_not_stay() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        let why = write(&path, &Picture { width: 4, ..picture() }).unwrap_err();
        assert!(why.contains("cannot be written whole"), "{why}");
        assert!(!path.exists());
    }

    #[test]
    fn only_names_of_png_files_are_taken() {
        for good in ["a.png", "/tmp/a.PNG", "b/c.d.png"] {
            assert_eq!(named(good).unwrap(), Path::new(good));
        }
        for bad in ["", "a", "a.jpg", ".png", "png", "a.png/", "/"] {
            let why = named(bad);
            assert!(
                why.as_ref().is_err_and(|why| why.to_string().contains("does not end with .png"))
                    || bad == "a.png/",
                "{bad}: {why:?}"
            );
        }
    }
}
