//! The revision that this crate was built from, and the features that it was built with.

/// Commit of the sources, or the name of the last tag with the commits since; `None` where neither
/// a repository nor an archive of a release named it.
pub const REVISION: Option<&str> = option_env!("LUXEL_REVISION");

/// Returns the cargo features of this crate that change what it can do.
///
/// ```
/// assert_eq!(luxel_app::build_info::features().contains(&"gpu"), cfg!(feature = "gpu"));
/// ```
pub fn features() -> Vec<&'static str> {
    let all = [
        ("gpu", cfg!(feature = "gpu")),
        ("jpeg-xl", cfg!(feature = "jpeg-xl")),
        ("markers", cfg!(feature = "markers")),
        ("methods", cfg!(feature = "methods")),
        ("ocio", cfg!(feature = "ocio")),
    ];
    all.into_iter().filter(|(_, is_there)| *is_there).map(|(name, _)| name).collect()
}

/// Returns version, revision, features and target, one a line.
pub fn long_version() -> String {
    long_version_with(&features())
}

/// Returns the same for a program with these features.
pub fn long_version_with(features: &[&str]) -> String {
    let features = match features {
        [] => "none".to_owned(),
        some => some.join(", "),
    };
    let target = format!("{} {}", std::env::consts::ARCH, std::env::consts::OS);
    format!("{}\nrevision  {}\nfeatures  {features}\ntarget    {target}", luxel::VERSION, REVISION.unwrap_or("unknown"))
}
