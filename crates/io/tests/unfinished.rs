//! Files that a process leaves behind if it ends in the middle of writing. In a test program of its
//! own, as it is about all files of a process; where an open file can be removed.

#[cfg(unix)]
use luxel_io::{remove_unfinished, write_atomically};

#[cfg(unix)]
#[test]
fn a_process_that_ends_leaves_nothing_half_written() {
    let folder = tempfile::tempdir().unwrap();
    let files = || std::fs::read_dir(folder.path()).unwrap().count();
    let path = folder.path().join("scene.ply");
    std::fs::write(&path, "old").unwrap();
    let written = write_atomically(&path, |out| {
        out.write_all(b"half").unwrap();
        assert_eq!(files(), 2);
        remove_unfinished();
        assert_eq!(files(), 1);
        Ok(())
    });
    assert!(written.is_err());
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "old");
    // What is finished is not touched any more.
    write_atomically(&path, |out| out.write_all(b"new").map_err(|e| luxel_io::IoError::system(&path, "write", &e))).unwrap();
    remove_unfinished();
    assert_eq!((files(), std::fs::read_to_string(&path).unwrap().as_str()), (1, "new"));
}
