//! Reading that the formats of films share.

use std::io::{self, Read};

/// A reader that counts its bytes, so that an error can tell where a file is cut short.
#[derive(Debug)]
pub(super) struct Counted<R> {
    pub(super) reader: R,
    pub(super) offset: u64,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let bytes = self.reader.read(buffer)?;
        self.offset += bytes as u64;
        Ok(bytes)
    }
}
