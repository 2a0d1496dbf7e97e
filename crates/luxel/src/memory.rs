//! Memory of this process in bytes, on Linux; `None` elsewhere.

/// Returns the resident memory (`VmRSS`).
pub fn resident_bytes() -> Option<u64> {
    status_bytes("VmRSS:")
}

/// Returns the peak of resident memory (`VmHWM`).
pub fn peak_resident_bytes() -> Option<u64> {
    status_bytes("VmHWM:")
}

fn status_bytes(key: &str) -> Option<u64> {
    field_bytes(&std::fs::read_to_string("/proc/self/status").ok()?, key)
}

fn field_bytes(status: &str, key: &str) -> Option<u64> {
    let rest = status.lines().find_map(|line| line.strip_prefix(key))?;
    rest.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kilobytes_of_a_field_become_bytes() {
        let status = "Name:\tluxel\nVmHWM:\t    2048 kB\nVmRSS:\t 3 kB\n";
        assert_eq!(field_bytes(status, "VmHWM:"), Some(2048 * 1024));
        assert_eq!(field_bytes(status, "VmRSS:"), Some(3 * 1024));
        assert_eq!(field_bytes(status, "VmSwap:"), None);
    }
}
