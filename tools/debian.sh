# Functions for scripts that need packages of Debian, to be sourced.

die() {
  echo "error: $*" >&2
  exit 2
}

is_installed() {
  [[ "$(dpkg-query -W -f='${Status}' "$1" 2>/dev/null)" == "install ok installed" ]]
}

# Only what is missing, and only then touches apt.
install_packages() {
  if ! command -v apt-get >/dev/null; then
    echo "no apt-get here: taking it that what Debian calls $* is installed" >&2
    return
  fi
  local missing=() package
  for package; do
    is_installed "$package" || missing+=("$package")
  done
  [[ ${#missing[@]} -gt 0 ]] || return 0
  can_install ||
    die "missing Debian packages and neither root nor sudo to install them: ${missing[*]}"
  apt_install "${missing[@]}"
}

can_install() {
  [[ $(id -u) -eq 0 ]] || command -v sudo >/dev/null
}

apt_install() {
  local as_root=(env DEBIAN_FRONTEND=noninteractive)
  [[ $(id -u) -eq 0 ]] || as_root=(sudo "${as_root[@]}")
  echo "installing $*"
  # One broken third-party source fails the update as a whole; Debian's own lists may be fine.
  "${as_root[@]}" apt-get update -qq || echo "apt-get update failed; trying the lists at hand" >&2
  "${as_root[@]}" apt-get install -y -qq --no-install-recommends "$@"
}
