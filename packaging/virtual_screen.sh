# shellcheck shell=bash
# A virtual screen with a window manager (focus and dialogs behave like a desktop only with one). To be sourced:
# `start_virtual_screen` sets DISPLAY and returns when both are up; they end with the shell that started them.
# `has_display` checks whether one is needed at all.

# A DISPLAY that outlived its server (a stale variable) is none; one of another machine is taken at its word.
has_display() {
  if [[ $(uname -s) != Linux || -n ${WAYLAND_DISPLAY:-} ]]; then return 0; fi
  if [[ -z ${DISPLAY:-} ]]; then return 1; fi
  if [[ $DISPLAY =~ ^(unix)?:([0-9]+) ]]; then
    local socket=/tmp/.X11-unix/X${BASH_REMATCH[2]}
    [[ -S $socket ]] || grep -q "$socket\$" /proc/net/unix 2>/dev/null
  fi
}

virtual_screen_folder=
virtual_screen_pids=()

stop_virtual_screen() {
  local pid
  for pid in "${virtual_screen_pids[@]}"; do
    kill "$pid" 2>/dev/null || true
    wait "$pid" 2>/dev/null || true
  done
  virtual_screen_pids=()
  if [[ -n $virtual_screen_folder ]]; then rm -rf -- "$virtual_screen_folder"; fi
  virtual_screen_folder=
}

# virtual_screen_wait FILE PID: until FILE has content, for at most 20 s or while PID lives.
virtual_screen_wait() {
  local tries
  for ((tries = 0; tries < 200; tries++)); do
    [[ -s $1 ]] && return 0
    kill -0 "$2" 2>/dev/null || return 1
    sleep 0.1
  done
  return 1
}

virtual_screen_failed() {
  printf 'The virtual screen did not start (%s):\n' "$1" >&2
  cat -- "$virtual_screen_folder/log" >&2
  return 1
}

start_virtual_screen() {
  virtual_screen_folder=$(mktemp -d -t caris-screen.XXXXXX)
  trap stop_virtual_screen EXIT
  trap 'exit 130' INT
  trap 'exit 143' TERM
  # The server picks a free display number itself and writes it when it accepts connections.
  Xvfb -displayfd 3 -screen 0 1920x1080x24 -nolisten tcp -noreset \
    3>"$virtual_screen_folder/number" >"$virtual_screen_folder/log" 2>&1 &
  virtual_screen_pids=("$!")
  virtual_screen_wait "$virtual_screen_folder/number" "$!" || virtual_screen_failed Xvfb || return
  DISPLAY=:$(cat -- "$virtual_screen_folder/number")
  export DISPLAY
  unset WAYLAND_DISPLAY XAUTHORITY
  # openbox runs the start-up command once it manages the screen.
  openbox --sm-disable --startup "sh -c 'echo up >\"$virtual_screen_folder/manager\"'" >>"$virtual_screen_folder/log" 2>&1 &
  virtual_screen_pids=("$!" "${virtual_screen_pids[@]}")
  virtual_screen_wait "$virtual_screen_folder/manager" "$!" || virtual_screen_failed openbox
}
