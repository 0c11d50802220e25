# fish completion of blocks: blocks completion fish > ~/.config/fish/completions/blocks.fish
function __blocks_words
    set -l typed (commandline -opc)
    set -l current (commandline -ct)
    set -l lines ($typed[1] completion words -- $typed[2..-1] $current 2>/dev/null)
    switch "$lines[1]"
        case 'files' 'files *'
            __fish_complete_path $current
        case 'words*'
            printf '%s\n' $lines[2..-1]
    end
end
complete -c blocks -f -a '(__blocks_words)'
